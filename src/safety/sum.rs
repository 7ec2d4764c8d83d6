//! Check sums of plans. A sum needs less memory and copying than [two copies](super::Doubled). It is for plans that stay
//! the same from order to end.

use core::hash::{Hash, Hasher};

/// Words in turn. Each is combined by an exclusive or with the rotated sum of those before it.
struct Words(u32);

/// The sum of this value. A flipped bit always changes it.
#[inline(always)]
pub fn sum(value: &impl Hash) -> u32 {
    let mut words = Words(0);
    value.hash(&mut words);
    words.0
}

impl Hasher for Words {
    fn finish(&self) -> u64 {
        u64::from(self.0)
    }

    #[inline(always)]
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u32(u32::from(*byte));
        }
    }

    #[inline(always)]
    fn write_u8(&mut self, word: u8) {
        self.write_u32(u32::from(word));
    }

    #[inline(always)]
    fn write_u32(&mut self, word: u32) {
        self.0 = self.0.rotate_left(5) ^ word;
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "the two halves, one after the other")]
    fn write_u64(&mut self, word: u64) {
        self.write_u32(word as u32);
        self.write_u32((word >> 32) as u32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_flipped_bit_changes_it() {
        let value = (7_i64, -3_i32, 5_u32, -1_i8);
        for bit in 0..136 {
            let mut other = value;
            match bit {
                0..64 => other.0 ^= 1 << bit,
                64..96 => other.1 ^= 1 << (bit - 64),
                96..128 => other.2 ^= 1 << (bit - 96),
                _ => other.3 ^= 1 << (bit - 128),
            }
            assert_ne!(sum(&other), sum(&value), "bit {bit}");
        }
    }
}
