//! The states of a plant that act on the handle.
//!
//! A body floats if no spring connects it to the ground or to the handle. Then nothing depends on the position of this
//! body. This position would be an eigenvalue of 1 at every K and B, and rounding would decide about stability. So this
//! position is left out. A body behind a joint without spring and damper does not act on the handle, and is also left
//! out. If several bodies float together, only their positions relative to the first body are kept.

use nalgebra::{DMatrix, DVector};

use crate::scene::element::Chain;

/// Which states of a chain of bodies are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Acting {
    states: usize,
    /// Indices of the kept states. The handle's position and speed are the first two.
    kept: Vec<usize>,
    /// The indices of two floating bodies, one behind the other. The position of the first one is taken relative to the
    /// second one.
    relative: Option<[usize; 2]>,
}

impl Acting {
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

    pub(super) fn states(&self) -> usize {
        self.kept.len()
    }

    /// Reduces a step of the chain to the kept states. A step is `exp(A dt) - 1` and the response to a force.
    pub(super) fn reduce(
        &self,
        step: (DMatrix<f64>, DVector<f64>),
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (mut less, mut gamma) = step;
        if self.kept.len() == self.states {
            return (less, gamma);
        }
        if let Some([body, from]) = self.relative {
            // The other columns do not change, because a common motion of both bodies has no effect.
            let before = less.row(from).clone_owned();
            let mut row = less.row_mut(body);
            row -= before;
            gamma[body] -= gamma[from];
        }
        (less.select_rows(&self.kept).select_columns(&self.kept), gamma.select_rows(&self.kept))
    }
}
