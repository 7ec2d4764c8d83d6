//! A host can promise to send the command `alive` again within a certain time. If it fails to do so while the force is
//! on, the board notices the silence.

use crate::{
    period::SAMPLES_PER_MS,
    range::{SettingsError, within},
    safety::Doubled,
};

/// The promise of a host: the longest time from one command `alive` to the next. By default there is no promise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Promise {
    /// The time in samples. It is 0 without a promise.
    samples: u32,
}

impl Promise {
    /// The shortest time of a promise, in ms. It is longer than the task `link` may need for a line.
    const LEAST_MS: f64 = 20.0;
    /// Longest time of a promise, in ms.
    const MOST_MS: f64 = 10_000.0;

    /// The promise that `alive` comes again within `ms` milliseconds. With 0 there is no promise.
    ///
    /// # Errors
    /// The time is too short or too long.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "20 to 10,000")]
    pub fn of(ms: f64) -> Result<Self, SettingsError> {
        if ms == 0.0 {
            return Ok(Self::default());
        }
        let ms = within("alive", ms, Self::LEAST_MS..=Self::MOST_MS)?;
        Ok(Self { samples: ms as u32 * SAMPLES_PER_MS })
    }
}

/// What the board knows about the host: its promise, and the time of its last `alive`.
#[derive(Clone, Copy, Debug)]
pub struct Host {
    promise: Doubled<Promise>,
    /// Number of the last output's sample. `heard` is the number of the sample at the last `alive`.
    now: u32,
    heard: Doubled<u32>,
}

impl Default for Host {
    fn default() -> Self {
        Self { promise: Doubled::new(Promise::default()), now: 0, heard: Doubled::new(0) }
    }
}

impl Host {
    /// Whether promise and time are unchanged.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.promise.is_whole() && self.heard.is_whole()
    }

    /// Flips a bit of the second copy of the time.
    #[cfg(test)]
    pub(crate) fn spoil(&mut self) {
        self.heard.spoil(*self.heard ^ 1 << 16);
    }

    /// Notes that `alive` has come, and the promise about the next one.
    pub fn hear(&mut self, promise: Promise) {
        self.promise.set(promise);
        self.heard.set(self.now);
    }

    /// Whether the promise is broken at the output of `sample`, or would be broken at the next output, `period` samples
    /// later. Returns true once. A silence with the force off is ignored.
    #[inline]
    pub fn falls_silent(&mut self, sample: u64, period: u32, on: bool) -> bool {
        #[expect(clippy::cast_possible_truncation, reason = "modulo 2^32, five days")]
        {
            self.now = sample as u32;
        }
        if !on {
            self.heard.set(self.now);
        }
        let silent = self.now.wrapping_sub(*self.heard).saturating_add(period);
        let broken = self.promise.samples != 0 && silent >= self.promise.samples;
        if broken {
            self.promise.set(Promise::default());
        }
        broken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_promise_is_none_or_20_ms_to_10_s() {
        assert_eq!(Promise::of(0.0), Ok(Promise::default()));
        assert_eq!(Promise::of(200.0), Ok(Promise { samples: 2_000 }));
        for ms in [-1.0, 0.1, 19.9, 10_000.1, f64::NAN, f64::INFINITY] {
            assert!(Promise::of(ms).is_err(), "{ms}");
        }
    }

    /// Flips every bit. Some flips would make the time so long that a silent host would not be found.
    #[test]
    fn a_promise_of_which_a_bit_flips_is_found() {
        let mut host = Host::default();
        host.hear(Promise::of(1234.0).unwrap());
        assert!(host.is_whole());
        for bit in 0..32 {
            let mut broken = host;
            broken.promise.spoil(Promise { samples: host.promise.samples ^ 1 << bit });
            assert!(!broken.is_whole(), "{bit}");
            let mut broken = host;
            broken.heard.spoil(*host.heard ^ 1 << bit);
            broken.falls_silent(100, 10, true);
            assert!(!broken.is_whole(), "{bit}");
        }
    }

    #[test]
    fn silence_is_found_in_time_and_once() {
        for period in [1, 2, 5, 10] {
            // Sample numbers wrap meanwhile.
            let begin = u64::from(u32::MAX) - 500;
            let mut host = Host::default();
            assert!(!host.falls_silent(begin, period, true));
            host.hear(Promise::of(200.0).unwrap());
            let found = (1..=3_000)
                .find(|n| host.falls_silent(begin + n * u64::from(period), period, true));
            // The output after this finding switches off. This is not later than the promise allows, and at most one
            // output too soon.
            let off = found.unwrap() * u64::from(period) + u64::from(period);
            assert!((2_000..=2_000 + u64::from(period)).contains(&off), "{period}: {off}");
            assert!((1..=3_000).all(|n| !host.falls_silent(begin + 4_000 + n, period, true)));
        }
    }
    #[test]
    fn with_the_force_off_silence_does_not_count_and_the_promise_stays() {
        let mut host = Host::default();
        assert!(!host.falls_silent(0, 10, false));
        host.hear(Promise::of(200.0).unwrap());
        assert!((1..=1_000).all(|n| !host.falls_silent(10 * n, 10, false)));
        let found = (1_001..=3_000).find(|n| host.falls_silent(10 * n, 10, true));
        assert_eq!(found, Some(1_199), "2,000 samples after the last output that was off");
    }
}
