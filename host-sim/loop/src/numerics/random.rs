//! Random numbers that depend only on seed and sample number. They do not depend on threads or on other draws.
//!
//! Source: the output function of SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators",
//! OOPSLA 2014) on a counter; Box and Muller, Ann. Math. Stat. 29, 1958.

use core::f64::consts::TAU;

/// Number n of the SplitMix64 sequence with this seed.
#[inline]
pub fn bits(seed: u64, n: u64) -> u64 {
    let mut z = seed.wrapping_add(n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The upper 53 bits as a whole number.
fn high(bits: u64) -> f64 {
    (bits >> 11) as f64
}

/// Uniform over (0, 1).
#[inline]
pub fn uniform(seed: u64, n: u64) -> f64 {
    (high(bits(seed, n)) + 0.5) / (1u64 << 53) as f64
}

/// Uniform over [0, 1).
#[inline]
pub fn uniform_with_zero(seed: u64, n: u64) -> f64 {
    high(bits(seed, n)) / (1u64 << 53) as f64
}

/// A Gaussian number from two uniform numbers. `radius` is uniform over (0, 1], `angle` over (0, 1) or [0, 1).
#[inline]
pub fn box_muller(radius: f64, angle: f64) -> f64 {
    libm::sqrt(-2.0 * libm::log(radius)) * libm::cos(TAU * angle)
}

/// Gaussian number with mean 0 and variance 1.
#[inline]
pub fn gaussian(seed: u64, n: u64) -> f64 {
    box_muller(uniform(seed, 2 * n), uniform(seed, 2 * n + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_those_of_splitmix64() {
        // the first numbers that the reference implementation gives after seed 1234567
        let expected =
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423];
        assert_eq!([0, 1, 2].map(|n| bits(1_234_567, n)), expected);
    }

    #[test]
    fn gaussian_has_the_moments_of_one() {
        let n = 200_000u32;
        let draws: Vec<f64> = (0..u64::from(n)).map(|i| gaussian(7, i)).collect();
        let mean_of = |power: i32| draws.iter().map(|x| x.powi(power)).sum::<f64>() / f64::from(n);
        // The limits are four standard errors: sqrt(1/n), sqrt(2/n), sqrt(15/n) and sqrt(96/n).
        for (power, expected, error) in
            [(1, 0.0, 0.009), (2, 1.0, 0.013), (3, 0.0, 0.035), (4, 3.0, 0.088)]
        {
            assert!((mean_of(power) - expected).abs() < error, "{power}: {}", mean_of(power));
        }
        let product: f64 = draws.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / f64::from(n);
        assert!(product.abs() < 0.009, "neighbours depend on each other: {product}");
    }
}
