//! What lanes measure in addition to the counts: motion, and outputs at the actuator's limit. The operations have the
//! same order as in [`Watch`](crate::simulation::window::Watch).

use super::{Aligned, Chunk, Row, each_field};
use crate::{
    engine::simd_ops::{SimdOps, lanes, lanes_mut},
    simulation::window::Watch,
};

/// The sums of [`Watch`] over the window, in the same order.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Watched<S: SimdOps>([S::f64s; 6]);

impl<S: SimdOps> Watched<S> {
    pub fn new(simd: S) -> Self {
        Self([simd.splat_f64s(0.0); 6])
    }

    pub fn clear(&mut self, place: usize) {
        for sum in &mut self.0 {
            lanes_mut(sum)[place] = 0.0;
        }
    }

    /// Adds an output to the sums of the lanes that are `watching`.
    #[inline(always)]
    pub fn output(&mut self, simd: S, output: S::f64s, watching: S::u64s) {
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let inside = simd.less_than_f64s(simd.magnitude(output), one);
        let [_, _, at_limit, outputs, forces, force_squares] = &mut self.0;
        let counts = simd.masked(simd.choose(inside, zero, one), watching);
        *at_limit = simd.add_f64s(*at_limit, counts);
        *outputs = simd.add_f64s(*outputs, simd.masked(one, watching));
        let force = simd.masked(output, watching);
        *forces = simd.add_f64s(*forces, force);
        *force_squares = simd.add_f64s(*force_squares, simd.mul_f64s(force, force));
    }

    pub fn lane(&self, place: usize, origin_m: f64) -> Watch {
        let sums = self.0.each_ref().map(|vector| lanes::<_, f64>(vector)[place]);
        let [sum_m, squares, at_limit, outputs, forces, force_squares] = sums;
        Watch { origin_m, sum_m, squares, at_limit, outputs, forces, force_squares }
    }
}

/// The last positions of all lanes in m. The ring stores as many positions as a window has samples.
pub struct Motion<S: SimdOps, const R: usize> {
    rows: Vec<Row<S, R>>,
    /// Index of the oldest positions. The next positions replace them.
    next: usize,
}

impl<S: SimdOps, const R: usize> Motion<S, R> {
    pub fn new(simd: S, window: u32) -> Self {
        let row = Aligned([simd.splat_f64s(0.0); R]);
        Self { rows: vec![row; window as usize], next: 0 }
    }

    /// The positions of a lane in its last window, oldest first.
    pub fn lane(&self, vector: usize, place: usize) -> Vec<f64> {
        let (late, early) = self.rows.split_at(self.next);
        let get = |row: &Row<S, R>| lanes::<_, f64>(&row.0[vector])[place];
        early.iter().chain(late).map(get).collect()
    }

    #[inline(always)]
    fn push(&mut self, row: &Row<S, R>) {
        if let Some(place) = self.rows.get_mut(self.next) {
            *place = *row;
        }
        self.next = if self.next + 1 < self.rows.len() { self.next + 1 } else { 0 };
    }
}

impl<S: SimdOps, const P: usize, const R: usize> Chunk<'_, S, P, R> {
    /// Adds the positions of a block to the sums.
    #[inline(always)]
    pub(super) fn watch(&mut self, simd: S, block: &[Row<S, R>]) {
        let mut watched = each_field!(self.moving, watched);
        let (origin_m, watching) =
            (each_field!(self.kept, origin_m), each_field!(self.kept, watching));
        for row in block {
            for r in 0..R {
                let away_m = simd.masked(simd.sub_f64s(row.0[r], origin_m[r]), watching[r]);
                let [sum_m, squares, ..] = &mut watched[r].0;
                *sum_m = simd.add_f64s(*sum_m, away_m);
                *squares = simd.add_f64s(*squares, simd.mul_f64s(away_m, away_m));
            }
        }
        for r in 0..R {
            self.moving[r].watched = watched[r];
        }
        if let Some(motion) = &mut self.motion {
            for row in block {
                motion.push(row);
            }
        }
    }
}
