//! A plain scalar `f64` loop with the equations of a wall hit. The benchmarks compare the simulator with this loop. The
//! loop takes only the filter's coefficients from the simulator. At the stability boundary the loop is in a limit
//! cycle. So no state becomes subnormal.

use host_sim::simulation::twin::LowPass;
use zwidth::velocity::ButterworthDesign;

pub const SAMPLES: usize = 60_000;

/// Equations and state of an estimator. The input is the number of counts since the last sample. The output is a
/// velocity in counts per sample.
pub trait Filter {
    fn update(&mut self, moved: f64) -> f64;
    /// Gives the filter the speed of the handle at the next sample, in m/s.
    #[inline(always)]
    fn look(&mut self, _speed: f64) {}
    /// Gives the filter the actuator's force since the last sample, as a fraction of full scale.
    #[inline(always)]
    fn granted(&mut self, _force: f64) {}
}

impl<F: FnMut(f64) -> f64> Filter for F {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        self(moved)
    }
}

/// The paper's low-pass at 1500 Hz.
pub struct Butterworth {
    b0: f64,
    a: [f64; 2],
    x: [f64; 2],
    y: [f64; 2],
}

impl Default for Butterworth {
    fn default() -> Self {
        let LowPass { b: [b0, ..], a, .. } =
            ButterworthDesign::new(1500.0, 1.0 / T, false).unwrap().into();
        Self { b0, a, x: [0.0; 2], y: [0.0; 2] }
    }
}

impl Filter for Butterworth {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        let (Self { b0, a: [a1, a2], .. }, [x1, x2], [y1, y2]) = (&*self, self.x, self.y);
        let y = b0 * (moved + 2.0 * x1 + x2) - a1 * y1 - a2 * y2;
        (self.x, self.y) = ([moved, x1], [y, y1]);
        y
    }
}

const T: f64 = 1e-4;

/// Computes a wall hit from the equations alone. They are those of mass, quantiser, difference, estimator, wall,
/// saturation and latency.
#[inline(never)]
pub fn plain(mut filter: impl Filter, stiffness: f64, damping: f64) -> f64 {
    let (mass, b, k, rest) = (0.4160, 5.5195, 11.0626, 0.0517);
    let (t, resolution, full_scale, push) = (T, 1e-6, 5.906, 2.835);
    // With four terms of the matrix exponential, a step takes as long as the exact step.
    let (kk, bb) = (k / mass, b / mass);
    let xx = 1.0 - kk * t * t / 2.0;
    let xv = t - bb * t * t / 2.0;
    let (gx, gv) = (t * t / 2.0 / mass, (t - bb * t * t / 2.0) / mass);
    let (vx, vv) = (-kk * xv, 1.0 - bb * t + (bb * bb - kk) * t * t / 2.0);
    let wall = (0.07f64 / resolution).round();
    let (mut x, mut v, mut last) = (-rest, 0.0, 0.0);
    let (mut force, mut next) = (0.0, 0.0);
    let (mut sum, mut squares) = (0.0, 0.0);
    for n in 0..SAMPLES {
        let exact = (x + rest) / resolution;
        let towards_zero = exact as i64 as f64;
        let count = towards_zero - f64::from(u8::from(towards_zero > exact));
        let difference = count - last;
        last = count;
        filter.look(v);
        let y = filter.update(difference);
        if n % 10 == 0 {
            force = next; // one output of latency
            let depth = count - wall;
            let spring = depth * resolution;
            let reaction = stiffness * spring + damping * y * resolution / t;
            let reaction = if depth > 0.0 { reaction.max(0.0) } else { 0.0 };
            next = (push - reaction).clamp(-full_scale, full_scale);
            filter.granted(next / full_scale);
        }
        (x, v) = (xx * x + xv * v + gx * force, vx * x + vv * v + gv * force);
        if n >= 40_000 {
            sum += count - wall;
            squares += (count - wall) * (count - wall);
        }
    }
    (squares / 20_000.0 - (sum / 20_000.0).powi(2)).sqrt()
}
