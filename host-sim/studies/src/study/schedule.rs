//! Runs long work on all threads. The longest parts begin first, so that the other threads do not wait for them at the
//! end.

use std::{
    cmp::Reverse,
    sync::atomic::{AtomicUsize, Ordering},
};

use rayon::prelude::*;

/// How long a search takes, approximately.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Length {
    /// The search is for one parameter. Its hits run in lanes.
    Short,
    /// The search is for several parameters or several estimators. Its hits run in lanes.
    Long,
    /// The estimator cannot run in lanes, so its hits run one by one.
    Longest,
}

/// Calls `make` with the index of each of `lengths`, on all threads of the current pool. The longest pieces of work
/// begin first. The results have the order of `lengths`.
pub fn longest_first<T: Send>(lengths: &[Length], make: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let mut order: Vec<usize> = (0..lengths.len()).collect();
    order.sort_by_key(|n| Reverse(lengths[*n]));
    let begun = AtomicUsize::new(0);
    let next = || {
        let number = *order.get(begun.fetch_add(1, Ordering::Relaxed))?;
        Some((number, make(number)))
    };
    let threads = 0..rayon::current_num_threads();
    let on_one = |_| std::iter::from_fn(next).collect::<Vec<_>>();
    let mut made: Vec<(usize, T)> =
        threads.into_par_iter().with_max_len(1).flat_map_iter(on_one).collect();
    made.sort_by_key(|(number, _)| *number);
    made.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    #[test]
    fn the_longest_begin_first_and_the_results_stay_in_order() {
        use Length::{Long, Longest, Short};
        let begun = Mutex::new(vec![]);
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let make = |n: usize| {
            begun.lock().unwrap().push(n);
            10 * n
        };
        let lengths = [Short, Longest, Long, Short, Longest];
        let made = pool(1).install(|| longest_first(&lengths, make));
        assert_eq!(made, [0, 10, 20, 30, 40]);
        assert_eq!(*begun.lock().unwrap(), [1, 4, 2, 0, 3]);
        assert_eq!(pool(3).install(|| longest_first(&lengths, make)), made);
    }
}
