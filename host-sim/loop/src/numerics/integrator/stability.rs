//! How long the steps of an integrator may be: what a plant can do at its fastest, and what each method bears.
//!
//! A chain without force is `M x'' + D x' + K x = 0` with symmetric matrices that have no negative eigenvalue, and a
//! motion `q exp(s t)` of it obeys `m s^2 + d s + k = 0` with the numbers `m = q* M q`, `d = q* D q`, `k = q* K q`. So with
//! `D1`, `K1` the largest eigenvalues of `D` and `K` relative to `M`
//! ```text
//! |s| <= max(D1, sqrt(K1))
//! ```
//! Stops, cogging and friction that add to K and D only raise the bound, sticking removes a body and only lowers it:
//! taken where all of them are steepest it holds in every combination of contacts.
//!
//! Semi-implicit Euler, `v1 = v - h M^-1 (K x + D v)`, `x1 = x + h v1`, is solved by `q g^n` with
//! `m (g - 1)^2 + h d (g - 1) + h^2 k g = 0`, and both g lie inside the unit circle where `2 h d + h^2 k < 4 m`. So it is
//! stable if
//! ```text
//! 4 M - 2 h D - h^2 K   is positive definite
//! ```
//! and not otherwise: that matrix is the equation's at g = -1, which for g towards minus infinity is positive definite; if it is not
//! at -1, a real g at or beyond -1 lies between. Again more stiffness or damping only needs shorter steps. The amplifier, which
//! nothing acts back on, needs `h pole < 2`.
//!
//! Source: Tisseur, Meerbergen, "The quadratic eigenvalue problem", SIAM Review 43(2), 2001, section 3 (the numbers of a
//! motion); the rest is derived above.

use nalgebra::SMatrix;

/// A symmetric matrix over the bodies of a plant.
pub type Bodies = SMatrix<f64, 3, 3>;

/// What an integrator has to follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepDemand {
    /// `M^-1/2 K M^-1/2` where the elements are steepest, 1/s^2; rows of bodies that are not there are 0.
    stiffness: Bodies,
    /// The same of the damping, 1/s.
    damping: Bodies,
    /// The amplifier's pole, 1/s; 0 without one.
    pole_per_s: f64,
}

fn largest(matrix: Bodies) -> f64 {
    matrix.symmetric_eigenvalues().max()
}

impl StepDemand {
    /// That of a plant with `M^-1/2 K M^-1/2` and `M^-1/2 D M^-1/2` where its elements are steepest, 1/s^2 and 1/s, and
    /// an amplifier's pole, 1/s (0: none).
    pub fn new(stiffness: Bodies, damping: Bodies, pole_per_s: f64) -> Self {
        Self { stiffness, damping, pole_per_s }
    }

    /// No motion of the plant is faster, 1/s.
    pub fn fastest_per_s(&self) -> f64 {
        let stiffness = largest(self.stiffness).max(0.0).sqrt();
        largest(self.damping).max(stiffness).max(self.pole_per_s)
    }

    /// Steps of length h, in s, of semi-implicit Euler are stable.
    pub fn bears_euler(&self, h: f64) -> bool {
        self.pole_per_s * h < 2.0
            && largest(self.damping * (2.0 * h) + self.stiffness * (h * h)) < 4.0
    }

    /// Fewest steps in `sample_s` with which semi-implicit Euler is stable.
    pub fn euler_steps(&self, sample_s: f64) -> f64 {
        let bears = |steps: f64| self.bears_euler(sample_s / steps);
        let mut enough = 1.0;
        while !bears(enough) {
            enough *= 2.0;
        }
        let mut too_few = (0.5 * enough).floor();
        while enough - too_few > 1.0 {
            let middle = (0.5 * (too_few + enough)).floor();
            if bears(middle) {
                enough = middle;
            } else {
                too_few = middle;
            }
        }
        enough
    }
}
