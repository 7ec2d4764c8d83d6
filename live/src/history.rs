//! Stores every sample of the last minutes. Bins of 8, 64 and 512 samples store the smallest and largest values, so
//! that plots of long times are fast.

/// Number of rows that are stored: two minutes at 10 kHz.
pub const KEPT: usize = 1_200_000;
/// Number of rows in a bin, for each level of bins.
const LEVELS: [usize; 4] = [1, 8, 64, 512];
pub const SIGNALS: usize = 3;

/// One sample: position, velocity and force as the integers of the control loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// Position in counts, velocity in 2^-16 counts per sample, and force in 2^-30 of full scale.
    pub values: [i32; SIGNALS],
    /// Flags of the telemetry record.
    pub flags: u16,
}

/// A bin of consecutive rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bin {
    /// Smallest and largest value of each signal. In an empty bin the smallest value is above the largest.
    pub ends: [[i32; 2]; SIGNALS],
    /// The flags that are set in any row of the bin.
    pub flags: u16,
}

impl Bin {
    pub const EMPTY: Self = Self { ends: [[i32::MAX, i32::MIN]; SIGNALS], flags: 0 };

    pub fn is_empty(&self) -> bool {
        self.ends[0][0] > self.ends[0][1]
    }

    fn of(row: &Row) -> Self {
        Self { ends: row.values.map(|value| [value; 2]), flags: row.flags }
    }

    fn add(&mut self, other: &Self) {
        for ([low, high], [other_low, other_high]) in self.ends.iter_mut().zip(other.ends) {
            *low = (*low).min(other_low);
            *high = (*high).max(other_high);
        }
        self.flags |= other.flags;
    }
}

/// The rows of the last minutes, by number. The number of a row is the number of its sample, divided by
/// [`step`](Self::step).
#[derive(Debug)]
pub struct History {
    /// Number of samples from one row to the next.
    step: u64,
    /// Number of the row that comes after the newest row.
    end: u64,
    /// Number of the oldest row.
    begin: u64,
    levels: [Vec<Bin>; LEVELS.len()],
}

impl Default for History {
    fn default() -> Self {
        let levels = LEVELS.map(|rows| vec![Bin::EMPTY; KEPT.div_ceil(rows)]);
        Self { step: 1, end: 0, begin: 0, levels }
    }
}

impl History {
    /// Clears the history. From now on there is a row every `step` samples.
    pub fn restart(&mut self, step: u64) {
        *self = Self { step: step.max(1), ..Self::default() };
    }

    pub fn step(&self) -> u64 {
        self.step
    }

    /// Number of the oldest row, and number of the row that comes after the newest.
    pub fn rows(&self) -> [u64; 2] {
        [self.begin, self.end]
    }

    /// Adds the row of a sample. Missing rows before this row become gaps. If the sample number is smaller than the
    /// previous number, the board was reset, so the history is cleared.
    pub fn push(&mut self, sample: u64, row: &Row) {
        let number = sample / self.step;
        if number < self.end || number - self.end > KEPT as u64 {
            let step = self.step;
            self.restart(step);
        }
        if self.begin == self.end {
            (self.begin, self.end) = (number, number);
        }
        while self.end < number {
            self.put(&Bin::EMPTY);
        }
        self.put(&Bin::of(row));
    }

    fn put(&mut self, bin: &Bin) {
        let number = self.end;
        for (level, rows) in self.levels.iter_mut().zip(LEVELS) {
            let place = &mut level[place_of(number, rows)];
            // The first row of a bin replaces the bin of two minutes ago.
            if number.is_multiple_of(rows as u64) || number == self.begin {
                *place = Bin::EMPTY;
            }
            place.add(bin);
        }
        self.end = number + 1;
        self.begin = self.begin.max(self.end.saturating_sub((KEPT - LEVELS[3]) as u64));
    }

    /// Bins of `stride` rows each, beginning with row `first`. `stride` is a power of two, and `first` is a multiple of
    /// `stride`.
    pub fn bins(&self, first: u64, stride: u64, count: usize) -> Vec<Bin> {
        let level = LEVELS.iter().rposition(|&rows| rows as u64 <= stride).unwrap_or(0);
        let rows = LEVELS[level] as u64;
        let bin = |n: u64| {
            let (from, to) = (first + n * stride, first + (n + 1) * stride);
            let mut bin = Bin::EMPTY;
            let mut number = from;
            while number < to {
                if number + rows > self.begin && number < self.end {
                    bin.add(&self.levels[level][place_of(number, LEVELS[level])]);
                }
                number += rows;
            }
            bin
        };
        (0..count as u64).map(bin).collect()
    }

    pub fn row(&self, number: u64) -> Option<Row> {
        let bin = self.bins(number, 1, 1)[0];
        (!bin.is_empty())
            .then(|| Row { values: bin.ends.map(|[value, _]| value), flags: bin.flags })
    }

    /// The smallest number of rows per bin with which `rows` rows fit into `columns` bins. It is a power of two.
    pub fn stride(rows: u64, columns: u64) -> u64 {
        rows.div_ceil(columns.max(1)).max(1).next_power_of_two()
    }
}

fn place_of(number: u64, rows: usize) -> usize {
    #[expect(clippy::cast_possible_truncation, reason = "below the number of bins")]
    {
        (number / rows as u64 % KEPT.div_ceil(rows) as u64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(n: u64) -> Row {
        let value = ((n * 7919) % 10_007) as i32 - 5000;
        Row { values: [value, -value, value / 3], flags: 1 << (n % 5) }
    }

    /// Bins have the smallest and largest values of their rows. Tested at every stride, at both ends of the history,
    /// and after old rows have been replaced.
    #[test]
    fn bins_are_the_ends_of_their_rows() {
        let mut history = History::default();
        let rows = KEPT as u64 + 70_000;
        let start = 123;
        for n in start..rows {
            history.push(n, &row(n));
        }
        let [begin, end] = history.rows();
        assert!(end == rows && begin > start && end - begin > KEPT as u64 - 1000);
        for stride in [1, 2, 8, 16, 128, 512, 4096] {
            for from in [
                begin.next_multiple_of(stride),
                (end / 2) / stride * stride,
                (end - 9000) / stride * stride,
            ] {
                for (k, bin) in (0..).zip(history.bins(from, stride, 2)) {
                    let mut wanted = Bin::EMPTY;
                    for n in from + k * stride..(from + (k + 1) * stride).min(end) {
                        wanted.add(&Bin::of(&row(n)));
                    }
                    assert_eq!(bin, wanted, "stride {stride} from {from}");
                }
            }
        }
        assert_eq!(history.row(end - 1), Some(row(end - 1)));
        assert_eq!(history.row(end), None);
    }

    #[test]
    fn a_gap_is_empty_and_a_reset_begins_anew() {
        let mut history = History::default();
        history.restart(10);
        for n in [0, 10, 50, 60] {
            history.push(n, &row(n));
        }
        let there: Vec<bool> = (0..8).map(|n| history.row(n).is_some()).collect();
        assert_eq!(there, [true, true, false, false, false, true, true, false]);
        history.push(20, &row(20));
        assert_eq!((history.rows(), history.step()), ([2, 3], 10));
        assert_eq!(history.row(0), None);
        // after a jump by more than the whole history, no old row is left
        history.push(10 * (KEPT as u64 + 100), &row(7));
        assert_eq!(history.rows()[1] - history.rows()[0], 1);
    }

    #[test]
    fn strides_are_powers_of_two_that_suffice() {
        for (rows, columns, stride) in
            [(600_000, 1000, 1024), (1000, 1000, 1), (1001, 1000, 2), (0, 0, 1)]
        {
            assert_eq!(History::stride(rows, columns), stride);
        }
    }
}
