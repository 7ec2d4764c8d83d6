//! Converts the core's velocity to a signal of each format, and back.

use zwidth::units::Velocity;

/// Number type of a filter's input and output.
pub trait Signal: Copy {
    /// The signal nearest to `bits` LSB of the core's velocity, saturated. Only Q15 uses `fraction`.
    fn of_velocity(bits: i32, fraction: u32) -> Self;
    /// The velocity nearest to the signal, in LSB, saturated to `i32`.
    fn to_velocity(self, fraction: u32) -> i32;
    /// The signal in counts per sample, with all its digits.
    fn to_counts(self, fraction: u32) -> f64;
}

/// Number of LSB of the core's velocity in one count per sample.
const PER_COUNT: f64 = 65_536.0;

impl Signal for i32 {
    #[inline]
    fn of_velocity(bits: i32, _: u32) -> Self {
        bits
    }

    #[inline]
    fn to_velocity(self, _: u32) -> i32 {
        self
    }

    #[inline]
    fn to_counts(self, _: u32) -> f64 {
        f64::from(self) / PER_COUNT
    }
}

impl Signal for i16 {
    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "clamped")]
    fn of_velocity(bits: i32, fraction: u32) -> Self {
        let rounded = match Velocity::FRACTION_BITS - fraction {
            0 => bits,
            dropped => ((bits >> (dropped - 1)) + 1) >> 1,
        };
        rounded.clamp(i16::MIN.into(), i16::MAX.into()) as i16
    }

    #[inline]
    fn to_velocity(self, fraction: u32) -> i32 {
        i32::from(self) << (Velocity::FRACTION_BITS - fraction)
    }

    #[inline]
    fn to_counts(self, fraction: u32) -> f64 {
        f64::from(self.to_velocity(fraction)) / PER_COUNT
    }
}

impl Signal for f32 {
    #[inline]
    #[expect(clippy::cast_precision_loss, reason = "24 bits are what it has")]
    fn of_velocity(bits: i32, _: u32) -> Self {
        bits as f32 * (1.0 / 65_536.0)
    }

    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "saturates, as it must")]
    fn to_velocity(self, _: u32) -> i32 {
        let scaled = self * 65_536.0;
        (scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32
    }

    #[inline]
    fn to_counts(self, _: u32) -> f64 {
        self.into()
    }
}

impl Signal for f64 {
    #[inline]
    fn of_velocity(bits: i32, _: u32) -> Self {
        f64::from(bits) / PER_COUNT
    }

    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "saturates, as it must")]
    fn to_velocity(self, _: u32) -> i32 {
        let scaled = self * PER_COUNT;
        (scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32
    }

    #[inline]
    fn to_counts(self, _: u32) -> f64 {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[expect(clippy::cast_possible_truncation, reason = "the nearest f32 will do")]
    fn a_velocity_becomes_the_nearest_signal_and_comes_back() {
        assert_eq!(i16::of_velocity(127, 8), 0);
        assert_eq!(i16::of_velocity(128, 8), 1);
        assert_eq!(i16::of_velocity(-129, 8), -1);
        assert_eq!(i16::of_velocity(i32::MIN, 8), i16::MIN);
        assert_eq!(i16::of_velocity(i32::MAX, 0), i16::MAX);
        assert_eq!(Signal::to_velocity(300i16, 8), 300 << 8);
        assert_eq!(i16::MAX.to_velocity(0), 32_767 << 16);
        for bits in [0, 1, -1, 77, -5_000_000, i32::MAX, i32::MIN] {
            assert_eq!(f64::of_velocity(bits, 0).to_velocity(0), bits);
            assert_eq!(i32::of_velocity(bits, 0).to_velocity(0), bits);
        }
        assert_eq!(f32::of_velocity(8_388_607, 0).to_velocity(0), 8_388_607);
        for (lsb, nearest) in [(1.6, 2), (-1.6, -2), (-1.4, -1)] {
            assert_eq!((lsb / PER_COUNT).to_velocity(0), nearest);
            assert_eq!((lsb as f32 / 65_536.0).to_velocity(0), nearest);
        }
        assert_eq!(f32::of_velocity(-3, 0).to_counts(0), -3.0 / 65_536.0);
    }
}
