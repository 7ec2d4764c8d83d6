//! Number of flips for each result, and shares of all flips.

use std::collections::BTreeMap;

use serde::Serialize;

#[derive(Serialize)]
pub struct Tally<K: Ord>(BTreeMap<K, u64>);

impl<K: Ord> Tally<K> {
    pub fn of(each: impl Iterator<Item = K>) -> Self {
        let mut counts = BTreeMap::new();
        each.for_each(|key| *counts.entry(key).or_default() += 1);
        Self(counts)
    }

    pub fn count(&self, key: K) -> u64 {
        self.0.get(&key).copied().unwrap_or_default()
    }

    pub fn all(&self) -> u64 {
        self.0.values().sum()
    }

    pub fn share(&self, key: K) -> [f64; 3] {
        share(self.count(key), self.all())
    }
}

/// The share `of / all`, and the lower and upper end of its 95 % interval by Wilson's formula.
fn share(of: u64, all: u64) -> [f64; 3] {
    const Z: f64 = 1.96;
    if all == 0 {
        return [0.0, 0.0, 1.0];
    }
    #[expect(clippy::cast_precision_loss, reason = "counts of runs")]
    let (n, p) = (all as f64, of as f64 / all as f64);
    let middle = p + Z * Z / (2.0 * n);
    let half = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    let whole = 1.0 + Z * Z / n;
    [p, ((middle - half) / whole).max(0.0), ((middle + half) / whole).min(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With no case of n = 10,000, Wilson's interval ends at z^2 / (n + z^2). With half of all cases, the interval is
    /// symmetric.
    #[test]
    fn a_share_has_its_interval() {
        let [share_0, low, high] = share(0, 10_000);
        assert_eq!((share_0, low), (0.0, 0.0));
        assert!((high - 3.841_6 / 10_003.841_6).abs() < 1e-9, "{high}");
        let [half, low, high] = share(500, 1_000);
        assert!((half - 0.5).abs() < 1e-12 && (low + high - 1.0).abs() < 1e-12);
        assert!((0.469..0.470).contains(&low), "{low}");
    }
}
