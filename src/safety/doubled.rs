//! Stores a value twice. It is used for state that decides a force. If a bit flips in one of the two, a comparison
//! shows it.

use core::ops::Deref;

/// A value and its copy. Dereferencing gives the value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Doubled<T> {
    value: T,
    copy: T,
}

impl<T: Copy + PartialEq> Doubled<T> {
    /// Stores this value twice.
    pub const fn new(value: T) -> Self {
        Self { value, copy: value }
    }

    /// Sets value and copy.
    #[inline(always)]
    pub fn set(&mut self, value: T) {
        *self = Self::new(value);
    }

    /// Changes value and copy, each from itself. So a flipped bit in one of the two stays visible. Returns what `change`
    /// returns for the value.
    #[inline(always)]
    pub fn change<R>(&mut self, mut change: impl FnMut(&mut T) -> R) -> R {
        change(&mut self.copy);
        change(&mut self.value)
    }

    /// Whether value and copy are equal.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.value == self.copy
    }
}

impl<T> Deref for Doubled<T> {
    type Target = T;

    #[inline(always)]
    fn deref(&self) -> &T {
        &self.value
    }
}

#[cfg(test)]
impl<T: Copy + PartialEq> Doubled<T> {
    /// Sets only the copy, as a flipped bit would.
    pub(crate) fn spoil(&mut self, copy: T) {
        self.copy = copy;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_of_the_two_gives_it_away_and_another_value_heals_it() {
        for (value, copy) in [(5, 4), (4, 5)] {
            let mut broken = Doubled { value, copy };
            assert!(!broken.is_whole());
            broken.set(7);
            assert!(broken.is_whole());
            assert_eq!(*broken, 7);
            let mut broken = Doubled { value, copy };
            assert_eq!(broken.change(|n| std::mem::replace(n, *n + 1)), value);
            assert_eq!((*broken, broken.is_whole()), (value + 1, false));
        }
    }
}
