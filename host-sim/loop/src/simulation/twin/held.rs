//! Dual-rate sampling: the position of every n-th sample, kept as such.

/// Where the handle is, and was at the last update; the first sample is one.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Held {
    position: f64,
    last: f64,
    samples: u32,
    velocity: f64,
}

impl Held {
    pub(super) fn update(&mut self, decimation: u32, difference: i32) -> f64 {
        self.position += f64::from(difference);
        if self.samples.is_multiple_of(decimation) {
            self.velocity = (self.position - self.last) / f64::from(decimation);
            self.last = self.position;
        }
        self.samples = self.samples.wrapping_add(1);
        self.velocity
    }
}
