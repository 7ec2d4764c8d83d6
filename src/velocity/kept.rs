//! The memory of an estimator, as bytes and as a sum. A reader of telemetry continues from the bytes. `render` checks
//! the sum.
//!
//! The least significant byte comes first. There is no padding. They contain only values on which a later velocity
//! depends. So two states with the same bytes give the same velocities for the same counts.
//!
//! The sum is the sum of the words, modulo 2^32. The estimator adds and subtracts its own changes to a stored sum.
//! After a flipped bit the sum of the words differs from the stored sum.

use crate::units::Velocity;

pub(super) struct Bytes<'a> {
    place: &'a mut [u8],
    used: usize,
}

impl<'a> Bytes<'a> {
    pub(super) const fn new(place: &'a mut [u8]) -> Self {
        Self { place, used: 0 }
    }

    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        let place = self.place.get_mut(self.used..).and_then(<[u8]>::first_chunk_mut::<N>);
        if let Some(place) = place {
            *place = bytes;
        }
        self.used += N;
    }

    /// Returns the number of bytes, or `None` if there was not room for all.
    pub(super) fn used(&self) -> Option<usize> {
        (self.used <= self.place.len()).then_some(self.used)
    }
}

/// A value in an estimator's memory.
pub(super) trait Kept: Sized {
    fn put(&self, bytes: &mut Bytes<'_>);

    /// Reads the value from the first bytes of `rest`, and moves `rest` behind them.
    fn take(rest: &mut &[u8]) -> Option<Self>;

    /// Returns the sum of the value's words, modulo 2^32. This takes only a few cycles.
    fn sum(&self) -> u32;

    /// Whether the part that the sum does not cover is unchanged.
    fn is_whole(&self) -> bool {
        true
    }
}

macro_rules! integers {
    ($($integer:ty: |$value:ident| $sum:expr;)*) => {$(
        impl Kept for $integer {
            fn put(&self, bytes: &mut Bytes<'_>) {
                bytes.put(self.to_le_bytes());
            }

            fn take(rest: &mut &[u8]) -> Option<Self> {
                let (bytes, behind) = rest.split_first_chunk()?;
                *rest = behind;
                Some(Self::from_le_bytes(*bytes))
            }

            #[inline(always)]
            fn sum(&self) -> u32 {
                let $value = *self;
                $sum
            }
        }
    )*};
}

integers! {
    u16: |value| value.into();
    i16: |value| i32::from(value).cast_unsigned();
    u32: |value| value;
    i32: |value| value.cast_unsigned();
    i64: |value| {
        let value = value.cast_unsigned();
        #[expect(clippy::cast_possible_truncation, reason = "its halves are meant")]
        let [low, high] = [value as u32, (value >> 32) as u32];
        low.wrapping_add(high)
    };
}

/// Implements [`Kept`] for a struct whose fields are all part of the memory.
macro_rules! kept {
    ($name:ident { $($field:ident),* }) => {
        impl $crate::velocity::kept::Kept for $name {
            fn put(&self, bytes: &mut $crate::velocity::kept::Bytes<'_>) {
                $($crate::velocity::kept::Kept::put(&self.$field, bytes);)*
            }

            fn take(rest: &mut &[u8]) -> Option<Self> {
                Some(Self { $($field: $crate::velocity::kept::Kept::take(rest)?,)* })
            }

            #[inline(always)]
            fn sum(&self) -> u32 {
                0u32$(.wrapping_add($crate::velocity::kept::Kept::sum(&self.$field)))*
            }

            #[inline(always)]
            fn is_whole(&self) -> bool {
                true $(&& $crate::velocity::kept::Kept::is_whole(&self.$field))*
            }
        }
    };
}
pub(super) use kept;

impl Kept for () {
    fn put(&self, _: &mut Bytes<'_>) {}

    fn take(_: &mut &[u8]) -> Option<Self> {
        Some(())
    }

    fn sum(&self) -> u32 {
        0
    }
}

impl Kept for Velocity {
    fn put(&self, bytes: &mut Bytes<'_>) {
        self.bits().put(bytes);
    }

    fn take(rest: &mut &[u8]) -> Option<Self> {
        i32::take(rest).map(Self::saturating_from_bits)
    }

    #[inline(always)]
    fn sum(&self) -> u32 {
        self.bits().sum()
    }
}

impl<T: Kept + Copy + Default, const N: usize> Kept for [T; N] {
    fn put(&self, bytes: &mut Bytes<'_>) {
        self.iter().for_each(|one| one.put(bytes));
    }

    fn take(rest: &mut &[u8]) -> Option<Self> {
        let mut all = [T::default(); N];
        for place in &mut all {
            *place = T::take(rest)?;
        }
        Some(all)
    }

    #[inline(always)]
    fn sum(&self) -> u32 {
        self.iter().fold(0, |sum, one| sum.wrapping_add(one.sum()))
    }

    #[inline(always)]
    fn is_whole(&self) -> bool {
        self.iter().all(T::is_whole)
    }
}
