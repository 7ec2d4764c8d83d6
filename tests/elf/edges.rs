//! The true ages of the encoder's edges, as the virtual board knows them.

use virtual_board::{board::Board, mcu::EdgeNotes};
use zwidth::velocity::Edge;

/// Core cycles per tick of the timers.
const TICK: u64 = 2;
/// Delay of the input filter in ticks. The filter needs 8 equal samples.
const FILTER: u64 = 8;

/// The latest edge of the count at each sample, and the number of edges within `near` ticks of a reading.
///
/// Samples have equal intervals. Ages are from the edge to the sample, in whole ticks. The first samples come when the
/// program is ready.
///
/// An edge is `None` if the handle reverses and crosses the last edge again between the readings. The firmware drops
/// such an edge (`src/velocity/edge_timer.rs`).
///
/// With `turned` the counter counts in the opposite direction.
pub fn latest(
    board: Board,
    notes: &EdgeNotes,
    near: u64,
    turned: bool,
) -> (Vec<Option<Edge>>, usize) {
    let per_sample = board.cycles_per_sample() / TICK;
    let mut phase = notes.captures_read_at[0] / TICK;
    let mut edges = notes.edges.iter().peekable();
    let (mut count, mut latest) = (None, None);
    let mut close = 0;
    // The firmware reads once before the first sample.
    let readings = notes.read_at[1..].iter().zip(&notes.captures_read_at).zip(&notes.captured_at);
    let ages = (0u64..).zip(readings).map(|(n, ((&read_at, &captures_read_at), captured_at))| {
        let now = captures_read_at / TICK;
        let mut nominal = now - (now - phase + per_sample / 2) % per_sample + per_sample / 2;
        if now.abs_diff(nominal) > 32 {
            assert!(n == 0, "sample {n} is not where it should be");
            (phase, nominal) = (now, now);
        }
        let mut new = None;
        while let Some(&&(at, to)) = edges.peek() {
            let seen = at / TICK + FILTER;
            close += usize::from(seen.abs_diff(read_at / TICK) <= near);
            if seen > read_at / TICK {
                break;
            }
            let up = count.is_none_or(|count| to > count) ^ turned;
            new = Some((seen, up));
            count = Some(to);
            edges.next();
        }
        // If the handle crosses the last edge again before the reading, the new crossing replaces the old crossing.
        let lost = edges.peek().zip(count).is_some_and(|(&&(at, to), count)| {
            let back = (to > count) ^ turned != new.is_some_and(|(_, up)| up);
            let read_at = captured_at[usize::from((count + 1) >> 1 & 1 == (to + 1) >> 1 & 1)];
            back && read_at.is_some_and(|read_at| at / TICK + FILTER <= read_at / TICK)
        });
        latest = match (new, latest) {
            _ if n == 0 => None,
            (Some(_), _) if lost => None,
            (Some((seen, up)), _) => {
                let ticks = nominal.saturating_sub(seen) << Edge::FRACTION_BITS;
                Some(Edge { age: u32::try_from(ticks / per_sample).unwrap(), up })
            }
            (None, Some(Edge { age, up })) => {
                Some(Edge { age: age.saturating_add(Edge::SAMPLE), up })
            }
            (None, None) => None,
        };
        latest
    });
    (ages.collect(), close)
}
