//! The forms in floating point, `f32` or `f64`.
//!
//! | form | equations | source |
//! |------|-----------|--------|
//! | direct form 1 | `y = b0 x + b1 x1 + b2 x2 - a1 y1 - a2 y2` | Oppenheim, Schafer, "Discrete-Time Signal Processing", 6.3 |
//! | transposed direct form 2 | `y = b0 x + s1; s1 = b1 x - a1 y + s2; s2 = b2 x - a2 y` | the same, 6.4 |
//! | state-variable | `v = d (g (x - s2) + s1); y = g v + s2; s1 = 2 v - s1; s2 = 2 y - s2` | Zavalishin, "The Art of VA Filter Design", 3.10 and 4.1 (trapezoidal integrators) |
//! | delta | `y = b0 x + s1; s1 += 4 b0 x - alpha1 y + s2; s2 += alpha2 (x - y)` | Middleton, Goodwin, "Digital Control and Estimation", 1990; `z = 1 + delta` |

use core::ops::{Add, Mul, Sub};

use crate::{Prototype, Signal, Step};

pub trait Float: Copy + Add<Output = Self> + Mul<Output = Self> + Sub<Output = Self> {
    const ZERO: Self;
    fn nearest(value: f64) -> Self;
}

impl Float for f32 {
    const ZERO: Self = 0.0;

    #[expect(clippy::cast_possible_truncation, reason = "the nearest is what is wanted")]
    fn nearest(value: f64) -> Self {
        value as Self
    }
}

impl Float for f64 {
    const ZERO: Self = 0.0;

    fn nearest(value: f64) -> Self {
        value
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Direct1<T> {
    b: [T; 3],
    a: [T; 2],
    x: [T; 2],
    y: [T; 2],
}

impl<T: Float> Direct1<T> {
    pub fn new(p: &Prototype) -> Self {
        Self {
            b: [p.b0(), 2.0 * p.b0(), p.b0()].map(T::nearest),
            a: [p.a1(), p.a2()].map(T::nearest),
            x: [T::ZERO; 2],
            y: [T::ZERO; 2],
        }
    }
}

impl<T: Float + Signal> Step for Direct1<T> {
    type Signal = T;

    #[inline]
    fn step(&mut self, x: T) -> T {
        let y = self.b[0] * x + self.b[1] * self.x[0] + self.b[2] * self.x[1]
            - self.a[0] * self.y[0]
            - self.a[1] * self.y[1];
        self.x = [x, self.x[0]];
        self.y = [y, self.y[0]];
        y
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Direct2Transposed<T> {
    b: [T; 3],
    a: [T; 2],
    s: [T; 2],
}

impl<T: Float> Direct2Transposed<T> {
    pub fn new(p: &Prototype) -> Self {
        let Direct1 { b, a, .. } = Direct1::new(p);
        Self { b, a, s: [T::ZERO; 2] }
    }
}

impl<T: Float + Signal> Step for Direct2Transposed<T> {
    type Signal = T;

    #[inline]
    fn step(&mut self, x: T) -> T {
        let y = self.b[0] * x + self.s[0];
        self.s[0] = self.b[1] * x - self.a[0] * y + self.s[1];
        self.s[1] = self.b[2] * x - self.a[1] * y;
        y
    }
}

#[derive(Clone, Copy, Debug)]
pub struct StateVariable<T> {
    g: T,
    d: T,
    s: [T; 2],
}

impl<T: Float> StateVariable<T> {
    pub fn new(p: &Prototype) -> Self {
        Self { g: T::nearest(p.g()), d: T::nearest(p.d()), s: [T::ZERO; 2] }
    }
}

impl<T: Float + Signal> Step for StateVariable<T> {
    type Signal = T;

    #[inline]
    fn step(&mut self, x: T) -> T {
        let v = self.d * (self.g * (x - self.s[1]) + self.s[0]);
        let y = self.g * v + self.s[1];
        self.s = [v + v - self.s[0], y + y - self.s[1]];
        y
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Delta<T> {
    b0: T,
    alpha1: T,
    /// Coefficient alpha2, equal to `4 b0`.
    alpha2: T,
    s: [T; 2],
}

impl<T: Float> Delta<T> {
    pub fn new(p: &Prototype) -> Self {
        let [b0, alpha1, alpha2] = [p.b0(), p.alpha1(), p.alpha2()].map(T::nearest);
        Self { b0, alpha1, alpha2, s: [T::ZERO; 2] }
    }
}

impl<T: Float + Signal> Step for Delta<T> {
    type Signal = T;

    #[inline]
    fn step(&mut self, x: T) -> T {
        let y = self.b0 * x + self.s[0];
        self.s[0] = self.s[0] + (self.alpha2 * x - self.alpha1 * y + self.s[1]);
        self.s[1] = self.s[1] + self.alpha2 * (x - y);
        y
    }
}
