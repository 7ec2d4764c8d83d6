//! [`WindowDifference`] in lanes: the change of the count over a window, divided by the window's number of samples. A
//! velocity is computed only when an output is due.

use pulp::bytemuck::cast_slice;
use zwidth::velocity::{Estimator, WindowDifference};

use super::{Beside, VectorForm};
use crate::engine::{
    lanes::Row,
    simd_ops::{SimdOps, lanes_mut},
};

/// Past positions of the handles of one vector, in counts from the start, and the window of each lane.
pub struct Mean<S: SimdOps> {
    /// Ring of the positions at the last samples.
    places: Vec<S::f64s>,
    newest: usize,
    /// Length of each lane's window: the number of samples from the oldest position to the newest.
    samples: Vec<usize>,
    /// The core's factor in two parts: the upper bits, and the last [`LAST`] bits.
    factor: [S::u64s; 2],
}

/// Length of the ring: a power of two, at least the longest window.
const LENGTH: usize = 256;
/// Number of bits in the second part of the factor. Both parts of the factor are below 2^31.
const LAST: u32 = 16;

impl<S: SimdOps> VectorForm<S> for Mean<S> {
    type Gains = ();

    fn at_rest(simd: S) -> (Self, ()) {
        let places = vec![simd.splat_f64s(0.0); LENGTH];
        let factor = [simd.splat_u64s(0); 2];
        (Self { places, newest: 0, samples: vec![1; S::F64_LANES], factor }, ())
    }

    fn start(&mut self, _: S, (): &mut (), lane: usize, estimator: &Estimator, _: Beside<'_>) {
        let Estimator::WindowDifference(mean) = estimator else { return };
        self.samples[lane] = mean.window_samples().into();
        let factor = mean.factor();
        let [first, last] = &mut self.factor;
        lanes_mut(first)[lane] = (factor >> LAST).cast_unsigned();
        lanes_mut(last)[lane] = (factor & ((1 << LAST) - 1)).cast_unsigned();
        for place in &mut self.places {
            lanes_mut(place)[lane] = 0.0;
        }
    }

    #[inline(always)]
    fn take<const R: usize>(
        forms: &mut [Self; R],
        simd: S,
        _: &[(); R],
        moved: &[Row<S, R>],
        due: bool,
        velocity: &mut [S::u64s; R],
    ) {
        for r in 0..R {
            let Mean { places, newest, samples, factor } = &mut forms[r];
            let Some(places) = places.first_chunk_mut::<LENGTH>() else { return };
            let mut place = places[*newest % LENGTH];
            for row in moved {
                place = simd.add_f64s(place, row.0[r]);
                *newest = (*newest + 1) % LENGTH;
                places[*newest] = place;
            }
            if due {
                moved_by(samples, lanes_mut(&mut place), cast_slice(places), *newest);
                velocity[r] = mean(simd, place, *factor);
            }
        }
    }

    fn is_lost(&self, (): &(), _: usize) -> bool {
        false
    }
}

/// The change of the count over each lane's window. In `places`, the positions of all lanes at one sample are side by
/// side.
fn moved_by(lanes: &[usize], counts: &mut [f64], places: &[f64], newest: usize) {
    for (lane, (samples, counts)) in lanes.iter().zip(counts).enumerate() {
        let at = |age: usize| places[(newest + LENGTH - age) % LENGTH * lanes.len() + lane];
        *counts = at(0) - at(*samples);
    }
}

/// The velocity in LSB, in the lower 32 bits. A count changes by less than 2^15 per sample, so the product is below
/// 2^55.
#[inline(always)]
fn mean<S: SimdOps>(simd: S, counts: S::f64s, [first, last]: [S::u64s; 2]) -> S::u64s {
    const BITS: u32 = WindowDifference::FACTOR_BITS;
    let of = |bits: u64| simd.splat_u64s(bits);
    let counts = simd.to_low(counts);
    let large = simd.shift_left(simd.product(counts, first), of(LAST.into()));
    let exact = simd.add_u64s(large, simd.product(counts, last));
    simd.shift_right(simd.add_u64s(exact, of(1 << (BITS - 1))), of(BITS.into()))
}
