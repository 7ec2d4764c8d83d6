//! Time stamping in `f64`.

use zwidth::velocity::{Edge, SPAN_MAX};

/// Number of stored edges: one for each sample of the longest span, and one older edge.
const LENGTH: usize = SPAN_MAX as usize + 2;
/// Number of samples without an edge after which the handle counts as at rest.
const STANDSTILL: f64 = 32_768.0;

#[derive(Clone, Copy, Debug)]
pub struct Stamps {
    /// Each entry is an edge: its time in samples and its position in counts. The newest edge is first.
    edges: [[f64; 2]; LENGTH],
    known: usize,
    now: f64,
    count: f64,
    measured: f64,
}

impl Stamps {
    pub const REST: Self =
        Self { edges: [[0.0; 2]; LENGTH], known: 0, now: 0.0, count: 0.0, measured: 0.0 };

    pub fn update(&mut self, span: f64, difference: i32, edge: Option<Edge>) -> f64 {
        self.now += 1.0;
        self.count += f64::from(difference);
        let sample = f64::from(Edge::SAMPLE);
        let edge = match edge {
            Some(edge) if difference != 0 || edge.age < Edge::SAMPLE => {
                Some((f64::from(edge.age.min(Edge::SAMPLE - 1)) / sample, edge.up))
            }
            // the age of the edge is unknown, so half the time of one count is assumed
            None if difference != 0 => {
                let age = 0.5 / f64::from(difference).abs();
                Some(((age * sample).floor() / sample, difference > 0))
            }
            _ => None,
        };
        if let Some((age, up)) = edge {
            self.edges.rotate_right(1);
            self.edges[0] = [self.now - age, self.count + f64::from(u8::from(!up))];
            self.known = (self.known + 1).min(LENGTH);
            self.measured = self.measure(span);
        }
        if self.known == 0 {
            return 0.0;
        }
        let age = self.now - self.edges[0][0];
        if age >= STANDSTILL {
            self.known = 0;
            self.measured = 0.0;
        }
        let bound = 1.0 / age;
        self.measured.clamp(-bound, bound).clamp(-32_767.0, 32_767.0)
    }

    /// Velocity from the latest edge and an older edge. The older edge is the newest edge that came at least the span
    /// minus half a sample before the latest edge. If there is no such edge, the oldest edge is used.
    fn measure(&self, span: f64) -> f64 {
        let span = span - 0.5;
        let edges = &self.edges[..self.known];
        let [time, place] = edges[0];
        let old = edges.iter().skip(1).find(|edge| time - edge[0] >= span);
        match old.or(edges[1..].last()) {
            Some(from) => (place - from[1]) / (time - from[0]).max(span),
            None => 0.0,
        }
    }
}
