//! Limits the share of the processor's time that a host can use with its commands. If a host sends more, its bytes wait
//! in the channel. No byte is refused.

/// The share: lines and their answers use at most 4 / `PARTS` of the time. Telemetry needs further time. At output
/// period 1 this is half as much.
const PARTS: u16 = 21;
/// Longest time that a line waits because of the lines before it, in ticks. With this limit the board still reads lines
/// if a bit of `rest` has flipped.
const LONGEST: u16 = 1200;

/// Says when the console may take bytes. `begun` is the clock of [`HaltWatch`](crate::safety::HaltWatch) at the
/// beginning of the last pass. For `rest` ticks after that, the board takes no byte.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pace {
    begun: u16,
    rest: u16,
}

impl Pace {
    /// Begins a pass. Returns whether the pass may take bytes.
    pub fn begin(&mut self, clock: u16) -> bool {
        let passed = clock.wrapping_sub(self.begun);
        self.begun = clock;
        // At least one tick counts as passed. So the board still listens when the clock stands still. In that case a
        // fault has already switched the force off.
        self.rest = self.rest.min(LONGEST).saturating_sub(passed.max(1));
        self.rest == 0
    }

    /// Ends a pass in which bytes were taken or a command was answered.
    pub fn end(&mut self, clock: u16) {
        let spent = clock.wrapping_sub(self.begun).max(1);
        self.rest = self.rest.saturating_add(spent.saturating_mul(PARTS) / 4);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the number of ticks from one line to the next, if a pass comes every `each` ticks and a line takes
    /// `line` ticks.
    fn between(each: u16, line: u16) -> u16 {
        let (mut pace, mut clock) = (Pace::default(), u16::MAX - 100);
        let mut at = [0; 2];
        for last in &mut at {
            while !pace.begin(clock) {
                clock = clock.wrapping_add(each);
            }
            *last = clock;
            pace.end(clock.wrapping_add(line));
            clock = clock.wrapping_add(line.max(1).next_multiple_of(each));
        }
        at[1].wrapping_sub(at[0])
    }

    #[test]
    fn lines_take_a_fifth_of_the_time() {
        for each in [4, 8, 20, 40] {
            for line in 0..80 {
                let time = between(each, line);
                assert!(time >= line * PARTS / 4 && time >= PARTS / 4, "{each} {line}: {time}");
                assert!(time < line.max(1) * PARTS / 4 + each, "{each} {line}: {time}");
            }
        }
    }

    #[test]
    fn lines_are_taken_though_the_clock_stands() {
        let mut pace = Pace::default();
        assert!(pace.begin(7));
        pace.end(7);
        assert!((0..PARTS).any(|_| pace.begin(7)));
    }

    #[test]
    fn nothing_is_waited_for_without_a_line_and_never_long() {
        let mut pace = Pace::default();
        assert!((0..1000u16).all(|n| pace.begin(n.wrapping_mul(40))));
        pace.rest = u16::MAX;
        assert!(!pace.begin(pace.begun));
        assert!(pace.begin(pace.begun.wrapping_add(LONGEST)));
    }
}
