//! The device with its linear elements as one system `z' = A z + b u`. u is the commanded force.
//!
//! The bodies are in a row: device, [`Mode`], [`Arm`]. A spring and a damper couple each body to the body before it.
//! The first and the last body are also coupled to the ground. The state has position and speed of each body, then the
//! amplifier's force if there is an amplifier:
//! ```text
//! z = (x0, v0, x1, v1, .., F)
//! ```
//! Positions are relative to the bodies' rest positions without a force. So the system has no constant term. With an
//! amplifier the number of states is odd.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use super::{Amplifier, Arm, Mode, Nonlinear};
use crate::{
    numerics::{
        exact::{discretise_increment, oscillator_increment},
        integrator::StepDemand,
    },
    scene::Device,
};

/// Largest number of states of a chain: three bodies and an amplifier.
pub const STATES_MAX: usize = 7;

/// Minus zero. If -0 is added to a number, no bit of the number changes. If +0 is added to -0, the sum is +0.
pub const NOTHING: f64 = -0.0;

/// Calls a generic function with the number of states, 2 to [`STATES_MAX`], that is only known at run time.
macro_rules! of_states {
    ($states:expr, $n:ident => $body:expr) => {
        of_states!($states, $n => $body, [2, 3, 4, 5, 6])
    };
    ($states:expr, $n:ident => $body:expr, [$($few:literal),*]) => {
        match $states {
            $($few => {
                const $n: usize = $few;
                $body
            })*
            _ => {
                const $n: usize = STATES_MAX;
                $body
            }
        }
    };
}
pub(crate) use of_states;

/// A device and the linear elements on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain {
    /// The body with motor and encoder.
    pub device: Device,
    pub mode: Option<Mode>,
    pub arm: Option<Arm>,
    pub amplifier: Option<Amplifier>,
    /// Constant force of a hand on the last body, in N.
    pub hand_n: f64,
    /// Constant force on the device in N.
    pub offset_n: f64,
}

/// One body: its mass, its coupling to the ground, and its coupling to the body before it.
#[derive(Clone, Copy, Debug, Default)]
struct Body {
    mass_kg: f64,
    ground: [f64; 2], // stiffness, damping
    joint: [f64; 2],
}

impl Chain {
    pub fn alone(device: Device) -> Self {
        Self { device, mode: None, arm: None, amplifier: None, hand_n: 0.0, offset_n: 0.0 }
    }

    pub fn states(&self) -> usize {
        2 + 2 * usize::from(self.mode.is_some())
            + 2 * usize::from(self.arm.is_some())
            + usize::from(self.amplifier.is_some())
    }

    fn bodies(&self) -> ([Body; 3], usize) {
        let device = &self.device;
        let first = Body {
            mass_kg: device.mass_kg,
            ground: [device.stiffness_n_per_m, device.damping_n_s_per_m],
            joint: [0.0; 2],
        };
        let mode = self.mode.map(|mode| Body {
            mass_kg: mode.mass_kg,
            ground: [0.0; 2],
            joint: [mode.stiffness_n_per_m, mode.damping_n_s_per_m],
        });
        let arm = self.arm.map(|arm| Body {
            mass_kg: arm.mass_kg,
            ground: [arm.stiffness_n_per_m, arm.damping_n_s_per_m],
            joint: [arm.grip_stiffness_n_per_m, arm.grip_damping_n_s_per_m],
        });
        let (mut bodies, mut count) = ([first, Body::default(), Body::default()], 1);
        for body in [mode, arm].into_iter().flatten() {
            bodies[count] = body;
            count += 1;
        }
        (bodies, count)
    }

    /// A and b of the system.
    ///
    /// # Panics
    /// N is not [`states`](Self::states).
    pub fn system<const N: usize>(&self) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
        assert_eq!(N, self.states(), "states of the chain");
        let (mut a, mut b) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
        let (bodies, count) = self.bodies();
        for (i, body) in bodies[..count].iter().enumerate() {
            let (x, v) = (2 * i, 2 * i + 1);
            a[(x, v)] = 1.0;
            // Stiffness and damping between this body and the ground, and between this body and both neighbours.
            let next = if i + 1 < count { bodies[i + 1].joint } else { [0.0; 2] };
            for (part, column) in [(0, x), (1, v)] {
                let own = body.ground[part] + body.joint[part] + next[part];
                a[(v, column)] = -own / body.mass_kg;
                if i > 0 {
                    a[(v, column - 2)] = body.joint[part] / body.mass_kg;
                }
                if i + 1 < count {
                    a[(v, column + 2)] = next[part] / body.mass_kg;
                }
            }
        }
        let mobility = 1.0 / self.device.mass_kg;
        match self.amplifier {
            None => b[1] = mobility,
            Some(amplifier) => {
                let pole = amplifier.pole_per_s();
                a[(1, N - 1)] = mobility;
                a[(N - 1, N - 1)] = -pole;
                b[N - 1] = pole;
            }
        }
        (a, b)
    }

    /// Acceleration that the constant forces cause in each state: the hand's force on the last body, and the offset on
    /// the device. All other values are -0, so adding them changes no bit of a sum.
    pub fn hand(&self) -> [f64; STATES_MAX] {
        let mut rates = [NOTHING; STATES_MAX];
        if self.hand_n != 0.0 {
            let (bodies, count) = self.bodies();
            rates[2 * count - 1] = self.hand_n / bodies[count - 1].mass_kg;
        }
        if self.offset_n != 0.0 {
            rates[1] += self.offset_n / self.device.mass_kg;
        }
        rates
    }

    /// Change of each state over `dt`, caused by the constant forces of hand and offset. It is -0 without forces.
    pub fn hand_moves(&self, dt: f64) -> [f64; STATES_MAX] {
        if self.hand_n == 0.0 && self.offset_n == 0.0 {
            return [NOTHING; STATES_MAX];
        }
        if self.states() == 2 {
            let gamma = self.increment(dt).1;
            let moves = |g: &f64| g * (self.hand_n + self.offset_n);
            return core::array::from_fn(|row| gamma.get(row).map_or(NOTHING, moves));
        }
        let rates = self.hand();
        of_states!(self.states(), N => {
            let (a, _) = self.system::<N>();
            let (_, moved) = discretise_increment(&a, &SVector::from_fn(|row, _| rates[row]), dt);
            core::array::from_fn(|row| moved.get(row).copied().unwrap_or(NOTHING))
        })
    }

    /// Rest position of each body without a force, in m. Unused entries are the device's position.
    ///
    /// The springs are in a row from the device's rest position to the arm's rest position. All springs carry the same
    /// force. A spring of stiffness 0 interrupts the row. Bodies behind the last interruption rest at the arm's rest
    /// position, all other bodies at the device's rest position.
    pub fn rest_m(&self) -> [f64; 3] {
        let origin = self.device.rest_position_m;
        let (bodies, count) = self.bodies();
        let Some(arm) = self.arm else { return [origin; 3] };
        // the springs in their order: the device's own spring, the joints, the arm's own spring
        let mut springs = [self.device.stiffness_n_per_m; 4];
        for i in 1..count {
            springs[i] = bodies[i].joint[0];
        }
        springs[count] = arm.stiffness_n_per_m;
        let springs = &springs[..=count];
        let gap = arm.rest_position_m - origin;
        let last_parted = springs.iter().rposition(|k| *k == 0.0);
        let force = gap / springs.iter().map(|k| 1.0 / k).sum::<f64>();
        let mut rest = [origin; 3];
        let mut stretch = 0.0;
        for (i, at) in rest[..count].iter_mut().enumerate() {
            match last_parted {
                Some(last) if i < last => {}
                Some(_) => *at = arm.rest_position_m,
                None => {
                    stretch += force / springs[i];
                    *at = origin + stretch;
                }
            }
        }
        rest
    }

    /// The matrix A, for any number of states.
    pub fn matrix(&self) -> DMatrix<f64> {
        of_states!(self.states(), N => {
            let (a, _) = self.system::<N>();
            DMatrix::from_fn(N, N, |row, column| a[(row, column)])
        })
    }

    /// The stiffness matrix K as `M^-1/2 K M^-1/2`, in 1/s^2, and the damping matrix in the same form, in 1/s. The given stiffness and damping are
    /// added to the device. Rows of absent bodies are 0.
    pub fn per_mass(
        &self,
        (stiffness_n_per_m, damping_n_s_per_m): (f64, f64),
    ) -> [SMatrix<f64, 3, 3>; 2] {
        let (mut bodies, count) = self.bodies();
        bodies[0].ground[0] += stiffness_n_per_m;
        bodies[0].ground[1] += damping_n_s_per_m;
        [0, 1].map(|part| {
            let mut matrix = SMatrix::<f64, 3, 3>::zeros();
            for (i, body) in bodies[..count].iter().enumerate() {
                matrix[(i, i)] += (body.ground[part] + body.joint[part]) / body.mass_kg;
                if i > 0 {
                    let before = bodies[i - 1].mass_kg;
                    matrix[(i - 1, i - 1)] += body.joint[part] / before;
                    let across = -body.joint[part] / libm::sqrt(before * body.mass_kg);
                    matrix[(i, i - 1)] = across;
                    matrix[(i - 1, i)] = across;
                }
            }
            matrix
        })
    }

    /// Plant properties that limit the step of an integrator. The `nonlinear` elements are included with their steepest
    /// slope.
    pub fn step_demand(&self, nonlinear: &Nonlinear) -> StepDemand {
        let [stiffness, damping] = self.per_mass(nonlinear.steepest());
        let pole_per_s = self.amplifier.map_or(0.0, |amplifier| amplifier.pole_per_s());
        StepDemand::new(stiffness, damping, pole_per_s)
    }

    /// `exp(A dt) - 1`, and the response to a unit force over `dt`. The number of states is only known at run time.
    pub fn increment(&self, dt: f64) -> (DMatrix<f64>, DVector<f64>) {
        if self.states() == 2 {
            let mass = self.device.mass_kg;
            let w2 = self.device.stiffness_n_per_m / mass;
            let step = oscillator_increment(w2, self.device.damping_n_s_per_m / mass, dt);
            let less = step.phi_minus_one;
            return (
                DMatrix::from_fn(2, 2, |row, column| less[row][column]),
                DVector::from_fn(2, |row, _| step.gamma[row] / mass),
            );
        }
        of_states!(self.states(), N => {
            let (a, b) = self.system::<N>();
            let (less, gamma) = discretise_increment(&a, &b, dt);
            (
                DMatrix::from_fn(N, N, |row, column| less[(row, column)]),
                DVector::from_fn(N, |row, _| gamma[row]),
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    fn paper() -> Chain {
        NamedScene::load("paper-1um").unwrap().scene.chain()
    }

    const ARM: Arm = Arm {
        mass_kg: 1.3,
        damping_n_s_per_m: 9.0,
        stiffness_n_per_m: 300.0,
        rest_position_m: 0.09,
        grip_damping_n_s_per_m: 20.0,
        grip_stiffness_n_per_m: 1500.0,
    };
    const MODE: Mode = Mode { mass_kg: 0.2, stiffness_n_per_m: 4e4, damping_n_s_per_m: 3.0 };

    /// Accelerations in a state, computed from the forces on each body. This calculation does not use the chain's row
    /// of bodies.
    fn accelerations(chain: &Chain, at_m: [f64; 3], speeds: [f64; 3], force_n: f64) -> Vec<f64> {
        let device = chain.device;
        let mut forces = [
            force_n
                - device.stiffness_n_per_m * (at_m[0] - device.rest_position_m)
                - device.damping_n_s_per_m * speeds[0],
            0.0,
            0.0,
        ];
        let mut masses = vec![device.mass_kg];
        let mut handle = 0;
        if let Some(mode) = chain.mode {
            let pull = mode.stiffness_n_per_m * (at_m[1] - at_m[0])
                + mode.damping_n_s_per_m * (speeds[1] - speeds[0]);
            forces[0] += pull;
            forces[1] -= pull;
            masses.push(mode.mass_kg);
            handle = 1;
        }
        if let Some(arm) = chain.arm {
            let last = handle + 1;
            let pull = arm.grip_stiffness_n_per_m * (at_m[last] - at_m[handle])
                + arm.grip_damping_n_s_per_m * (speeds[last] - speeds[handle]);
            forces[handle] += pull;
            forces[last] -= pull
                + arm.stiffness_n_per_m * (at_m[last] - arm.rest_position_m)
                + arm.damping_n_s_per_m * speeds[last];
            masses.push(arm.mass_kg);
        }
        masses.iter().zip(forces).map(|(mass, force)| force / mass).collect()
    }

    fn check<const N: usize>(chain: &Chain) {
        let (a, b) = chain.system::<N>();
        let (at_m, speeds, force_n) = ([0.03, 0.034, 0.041], [0.2, -0.3, 0.5], 1.7);
        let rest_m = chain.rest_m();
        let mut z = SVector::<f64, N>::zeros();
        for body in 0..N / 2 {
            z[2 * body] = at_m[body] - rest_m[body];
            z[2 * body + 1] = speeds[body];
        }
        if let Some(amplifier) = chain.amplifier {
            z[N - 1] = force_n;
            let rate = (a * z + b * 2.5)[N - 1];
            let expected = core::f64::consts::TAU * amplifier.bandwidth_hz * (2.5 - force_n);
            assert!((rate / expected - 1.0).abs() < 1e-14);
        }
        let command = if chain.amplifier.is_some() { 0.0 } else { force_n };
        let rates = a * z + b * command;
        for (body, expected) in accelerations(chain, at_m, speeds, force_n).iter().enumerate() {
            assert_eq!(rates[2 * body], speeds[body]);
            let error = rates[2 * body + 1] / expected - 1.0;
            assert!(error.abs() < 1e-12, "{chain:?}, body {body}: {error:e}");
        }
    }

    #[test]
    fn equations_of_motion_follow_from_the_forces() {
        let amplifier = Some(Amplifier { bandwidth_hz: 800.0 });
        let (mode, arm) = (Some(MODE), Some(ARM));
        check::<2>(&paper());
        check::<3>(&Chain { amplifier, ..paper() });
        check::<4>(&Chain { arm, ..paper() });
        check::<4>(&Chain { mode, ..paper() });
        check::<5>(&Chain { mode, amplifier, ..paper() });
        check::<6>(&Chain { mode, arm, ..paper() });
        check::<7>(&Chain { mode, arm, amplifier, ..paper() });
        let free = Device { stiffness_n_per_m: 0.0, ..paper().device };
        check::<6>(&Chain { mode, arm, ..Chain::alone(free) });
    }

    #[test]
    fn bodies_rest_where_no_force_moves_them() {
        let full = Chain { mode: Some(MODE), arm: Some(ARM), ..paper() };
        for broken in 0..16 {
            let mut chain = full;
            let arm = chain.arm.as_mut().unwrap();
            if broken & 1 != 0 {
                chain.device.stiffness_n_per_m = 0.0;
            }
            if broken & 2 != 0 {
                chain.mode.as_mut().unwrap().stiffness_n_per_m = 0.0;
            }
            if broken & 4 != 0 {
                arm.grip_stiffness_n_per_m = 0.0;
            }
            if broken & 8 != 0 {
                arm.stiffness_n_per_m = 0.0;
            }
            let still = accelerations(&chain, chain.rest_m(), [0.0; 3], 0.0);
            assert!(still.iter().all(|a| a.abs() < 1e-9), "{broken:04b}: {still:?}");
        }
        assert_eq!(paper().rest_m(), [0.0517; 3]);
    }
}
