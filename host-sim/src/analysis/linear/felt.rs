//! The states of a plant that act on the handle.
//!
//! A body that no spring holds, neither to the ground nor towards the handle, has a position on which nothing
//! depends: an eigenvalue of 1 at every K and B, and by its rounding the loop would be unstable or not. A body
//! behind a joint without spring and damper does not act at all. Both are left out, in coordinates in which they
//! stand alone: the stretch of each joint in place of the position of the body behind it.

use nalgebra::{DMatrix, DVector};

use crate::scene::element::Chain;

/// Which states of a chain are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Felt {
    /// States of the chain.
    states: usize,
    /// Those kept, by their place; the handle's position and speed are the first two.
    kept: Vec<usize>,
}

impl Felt {
    /// Those of that chain.
    pub(super) fn of(chain: &Chain) -> Self {
        let states = chain.states();
        let joints = [
            chain.mode.map(|mode| [mode.stiffness_n_per_m, mode.damping_n_s_per_m]),
            chain.arm.map(|arm| [arm.grip_stiffness_n_per_m, arm.grip_damping_n_s_per_m]),
        ];
        let is_held = chain.arm.is_some_and(|arm| arm.stiffness_n_per_m > 0.0);
        let mut kept = vec![0, 1];
        for (behind, joint) in joints.into_iter().flatten().enumerate() {
            if joint == [0.0; 2] {
                break;
            }
            let place = 2 * (behind + 1);
            if joint[0] > 0.0 || is_held {
                kept.push(place);
            }
            kept.push(place + 1);
        }
        if chain.amplifier.is_some() {
            kept.push(states - 1);
        }
        Self { states, kept }
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
        if self.kept.len() == self.states {
            return step;
        }
        let (mut less, mut gamma) = step;
        let positions = self.states / 2;
        // T less T^-1: a column takes in the ones of the bodies behind it, a row loses that of the body before it
        for body in (1..positions).rev() {
            let behind = less.column(2 * body).clone_owned();
            let mut before = less.column_mut(2 * (body - 1));
            before += behind;
        }
        for body in (1..positions).rev() {
            let before = less.row(2 * (body - 1)).clone_owned();
            let mut row = less.row_mut(2 * body);
            row -= before;
            gamma[2 * body] -= gamma[2 * (body - 1)];
        }
        (less.select_rows(&self.kept).select_columns(&self.kept), gamma.select_rows(&self.kept))
    }
}
