//! The states of a plant that act on the handle.
//!
//! Bodies that no spring holds, neither to the ground nor to the handle, have a place on which nothing depends: an
//! eigenvalue of 1 at every K and B, and by its rounding the loop would be unstable or not. What lies behind a joint
//! without spring and damper does not act at all. Both are left out; of several bodies that float together the places
//! relative to the first of them stay.

use nalgebra::{DMatrix, DVector};

use crate::scene::element::Chain;

/// Which states of a chain are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Acting {
    /// States of the chain.
    states: usize,
    /// Those kept, by their place; the handle's position and speed are the first two.
    kept: Vec<usize>,
    /// A body, and the floating one before it from which its place is taken.
    relative: Option<[usize; 2]>,
}

impl Acting {
    /// Those of that chain.
    pub(super) fn of(chain: &Chain) -> Self {
        let states = chain.states();
        let is_held = chain.arm.is_some_and(|arm| arm.stiffness_n_per_m > 0.0);
        let joints = [
            chain.mode.map(|mode| ([mode.stiffness_n_per_m, mode.damping_n_s_per_m], false)),
            chain.arm.map(|a| ([a.grip_stiffness_n_per_m, a.grip_damping_n_s_per_m], is_held)),
        ];
        let acts =
            |([stiffness, damping], _): &([f64; 2], bool)| *stiffness > 0.0 || *damping > 0.0;
        let bodies: Vec<_> = joints.into_iter().flatten().take_while(acts).collect();
        let (mut kept, mut relative) = (vec![0, 1], None);
        for (n, ([stiffness, _], held)) in bodies.iter().enumerate() {
            let position = 2 * (n + 1);
            let next = bodies.get(n + 1).filter(|([stiffness, _], _)| *stiffness > 0.0);
            let floats = *stiffness == 0.0 && !held && next.is_none_or(|(_, held)| !held);
            match (floats, next) {
                (false, _) => kept.push(position),
                (true, None) => {}
                (true, Some(_)) => relative = Some([position + 2, position]),
            }
            kept.push(position + 1);
        }
        if chain.amplifier.is_some() {
            kept.push(states - 1);
        }
        Self { states, kept, relative }
    }

    /// How many are kept.
    pub(super) fn states(&self) -> usize {
        self.kept.len()
    }

    /// A step of the chain, `exp(A dt) - 1` and its response to a force, in those states.
    pub(super) fn reduce(
        &self,
        step: (DMatrix<f64>, DVector<f64>),
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (mut less, mut gamma) = step;
        if self.kept.len() == self.states {
            return (less, gamma);
        }
        if let Some([body, from]) = self.relative {
            // the other columns do not change: where both move alike, nothing does
            let before = less.row(from).clone_owned();
            let mut row = less.row_mut(body);
            row -= before;
            gamma[body] -= gamma[from];
        }
        (less.select_rows(&self.kept).select_columns(&self.kept), gamma.select_rows(&self.kept))
    }
}
