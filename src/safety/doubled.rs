//! State that decides a force, kept twice: comparing the two shows a bit that has flipped in one of them.

use core::ops::Deref;

/// A value and its copy. It is read as the value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubled<T> {
    value: T,
    copy: T,
}

impl<T: Copy + PartialEq> Doubled<T> {
    /// Keeps this value twice.
    pub const fn new(value: T) -> Self {
        Self { value, copy: value }
    }

    /// Sets another value, with its copy.
    #[inline(always)]
    pub fn set(&mut self, value: T) {
        *self = Self::new(value);
    }

    /// Whether both are still the same.
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
    /// Changes a part of the value.
    pub(crate) fn edit(&mut self, change: impl FnOnce(&mut T)) {
        let mut value = self.value;
        change(&mut value);
        self.set(value);
    }
}

#[cfg(test)]
impl<T: Copy> Doubled<T> {
    /// A bit of the copy has flipped.
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
        }
    }
}
