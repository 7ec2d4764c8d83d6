//! Finds the largest stable step of an integrator. The step follows from the fastest motion of the plant and from the
//! stability limit of the method.
//!
//! A chain without force is `M x'' + D x' + K x = 0`. The matrices are symmetric and have no negative eigenvalues. A
//! motion `q exp(s t)` of the chain satisfies `m s^2 + d s + k = 0` with `m = q* M q`, `d = q* D q`, `k = q* K q`.
//! Let `D1` and `K1` be the largest eigenvalues of `D` and `K` relative to `M`. Then
//! ```text
//! |s| <= max(D1, sqrt(K1))
//! ```
//! Stops, cogging and friction add to K and D, and can only raise the bound. Sticking removes a body, and can only
//! lower the bound. So the bound at the steepest slope of all elements is valid in every combination of contacts.
//!
//! Semi-implicit Euler is `v1 = v - h M^-1 (K x + D v)`, `x1 = x + h v1`. Its solutions are `q g^n` with
//! `m (g - 1)^2 + h d (g - 1) + h^2 k g = 0`. Both g are inside the unit circle if `2 h d + h^2 k < 4 m`. So the method
//! is stable if
//! ```text
//! 4 M - 2 h D - h^2 K   is positive definite
//! ```
//! and unstable otherwise. At g = -1, the equation in g has this matrix. For g towards minus infinity, the equation's
//! matrix is positive definite. So if the matrix is not positive definite at g = -1, the equation has a real root g <=
//! -1. More stiffness or damping needs shorter steps. Nothing acts back on the amplifier, so the amplifier
//! only needs `h pole < 2`.
//!
//! Source: Tisseur, Meerbergen, "The quadratic eigenvalue problem", SIAM Review 43(2), 2001, section 3. It defines the
//! numbers m, d, k of a motion. The rest is derived above.

use nalgebra::SMatrix;

/// A symmetric matrix over the bodies of a plant.
pub type Bodies = SMatrix<f64, 3, 3>;

/// Plant properties that limit the step of an integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepDemand {
    /// `M^-1/2 K M^-1/2` at the steepest slope of the elements, in 1/s^2. Rows of absent bodies are 0.
    stiffness: Bodies,
    /// `M^-1/2 D M^-1/2` at the steepest slope of the elements, in 1/s. Rows of absent bodies are 0.
    damping: Bodies,
    /// The amplifier's pole in 1/s. It is 0 without an amplifier.
    pole_per_s: f64,
}

fn largest(matrix: Bodies) -> f64 {
    matrix.symmetric_eigenvalues().max()
}

impl StepDemand {
    /// The demand of a plant. `stiffness` is `M^-1/2 K M^-1/2` in 1/s^2, and `damping` is `M^-1/2 D M^-1/2` in 1/s,
    /// both at the steepest slope of the plant's elements. `pole_per_s` is the amplifier's pole in 1/s, or 0 without an
    /// amplifier.
    pub fn new(stiffness: Bodies, damping: Bodies, pole_per_s: f64) -> Self {
        Self { stiffness, damping, pole_per_s }
    }

    /// Upper bound of |s| over all motions `exp(s t)` of the plant, in 1/s.
    pub fn fastest_per_s(&self) -> f64 {
        let stiffness = largest(self.stiffness).max(0.0).sqrt();
        largest(self.damping).max(stiffness).max(self.pole_per_s)
    }

    /// Whether semi-implicit Euler is stable with steps of `h` seconds.
    pub fn bears_euler(&self, h: f64) -> bool {
        self.pole_per_s * h < 2.0
            && largest(self.damping * (2.0 * h) + self.stiffness * (h * h)) < 4.0
    }

    /// Smallest number of steps in `sample_s` with which semi-implicit Euler is stable.
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
