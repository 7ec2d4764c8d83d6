//! The walls that are predicted to be stable, out of the record of the image, judged by the rules of the page.

use crate::{board::Board, device};

/// One row: estimator, cutoff, B, lowest and highest K.
type Row = (String, f64, [f64; 3]);

/// The table of a board.
#[derive(Clone, Debug)]
pub struct Envelope {
    rows: Vec<Row>,
}

impl Envelope {
    /// The one that the board's image was built with.
    pub fn of(board: Board) -> Self {
        let rows = device::built_in(board).envelope.boundaries().flat_map(|(key, points)| {
            points.map(move |point| {
                let (low, high) = (point.stiffness_low_n_per_m, point.stiffness_high_n_per_m);
                let row = [point.damping_n_s_per_m, low, high];
                (key.estimator.text().to_owned(), key.cutoff_hz, row)
            })
        });
        Self { rows: rows.collect() }
    }

    /// B, lowest and highest K of that filter's boundary, at the period of the table.
    pub fn points(&self, estimator: &str, cutoff_hz: f64) -> Vec<[f64; 3]> {
        let same =
            |other: f64| (other - cutoff_hz).abs() <= 1e-9 * other.abs().max(cutoff_hz.abs());
        self.rows
            .iter()
            .filter(|(name, other, _)| name == estimator && same(*other))
            .map(|(_, _, row)| *row)
            .collect()
    }

    /// Whether a wall is inside.
    ///
    /// # Errors
    /// The reply that says what is allowed.
    pub fn allows(&self, estimator: &str, cutoff_hz: f64, k: f64, b: f64) -> Result<(), String> {
        if k == 0.0 && b == 0.0 {
            return Ok(());
        }
        let rows = self.points(estimator, cutoff_hz);
        let outside = |what: String| Err(format!("error: {what}, or unlock envelope"));
        let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
            return outside(format!(
                "no envelope for this device, estimator, cutoff, latency and output period{}",
                self.known()
            ));
        };
        if b > last[0] {
            return outside(format!("beyond the envelope: b is allowed from 0 to {}", last[0]));
        }
        let [low, high] = if b < first[0] {
            // Below the first B the line from nothing to the first point.
            [0.0, if first[1] == 0.0 { first[2] * (b / first[0]) } else { 0.0 }]
        } else {
            // Between two points what both allow.
            let beside = rows.windows(2).find(|pair| pair[0][0] <= b && b <= pair[1][0]);
            let (below, above) = match beside {
                Some([below, _]) if below[0] == b => (below, below),
                Some([_, above]) if above[0] == b => (above, above),
                Some([below, above]) => (below, above),
                _ => (last, last),
            };
            [f64::max(below[1], above[1]), f64::min(below[2], above[2])]
        };
        if high <= 0.0 || low > high {
            outside("beyond the envelope: no k is allowed at this b".into())
        } else if k < low || k > high {
            outside(format!("beyond the envelope: k at this b is allowed from {low} to {high}"))
        } else {
            Ok(())
        }
    }

    /// The cutoffs that it has, by estimator.
    fn known(&self) -> String {
        let (mut text, mut last) = (String::new(), ("", f64::NAN));
        for (estimator, cutoff_hz, _) in &self.rows {
            if last == (estimator, *cutoff_hz) {
                continue;
            }
            if last.0 != estimator {
                text += &format!("; known: {estimator}");
            }
            text += &format!(" {cutoff_hz}");
            last = (estimator, *cutoff_hz);
        }
        text
    }

    /// A wall at random near the border, for a cutoff that it has: cutoff, K, B.
    pub fn near(&self, pick: usize, above: f64) -> [f64; 3] {
        let (_, cutoff_hz, [b, _, high]) = &self.rows[pick % self.rows.len()];
        [*cutoff_hz, (high * above).round(), *b]
    }
}
