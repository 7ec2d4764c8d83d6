//! Replies held against what they should be: words exactly, numbers to the digits that are printed.

/// Two of the last of 12 digits: a limit is rounded inwards.
const SAME: f64 = 2e-11;

/// Whether `said` is `expected`: word by word. Some words stand for several; without `numbers` any number will do.
pub fn same(said: &str, expected: &str, numbers: bool) -> bool {
    let (mut left, mut right) = (words(said), words(expected));
    loop {
        match (left.next(), right.next()) {
            (None, None) => return true,
            (Some(said), Some(expected)) if matches(said, expected, numbers) => {}
            _ => return false,
        }
    }
}

/// Both states before `armed` are one to the model.
fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(' ').filter(|word| !matches!(*word, "sign" | "ramping"))
}

fn matches(said: &str, expected: &str, numbers: bool) -> bool {
    if said == expected {
        return true;
    }
    if expected == "arming," {
        return matches!(said, "test," | "in,");
    }
    let (said, expected) =
        (said.trim_end_matches([',', ';']), expected.trim_end_matches([',', ';']));
    if expected == "COMMIT" {
        let hash = said.strip_suffix("-dirty").unwrap_or(said);
        return said == "unknown"
            || hash.len() == 12 && hash.bytes().all(|b| b.is_ascii_hexdigit());
    }
    match (said.parse::<f64>(), expected.parse::<f64>()) {
        (Ok(said), Ok(expected)) => {
            !numbers
                || said == expected
                || (said - expected).abs() <= SAME * said.abs().max(expected.abs())
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_count_exactly_and_numbers_to_their_digits() {
        assert!(same("ok k 0.333333333333 N/m", "ok k 0.3333333333333333 N/m", true));
        assert!(same("ok k 1e-7 N/m", "ok k 0.0000001 N/m", true));
        assert!(!same("ok k 0.3333 N/m", "ok k 0.3333333333333333 N/m", true));
        assert!(same("code 2048, x", "code 17, x", false));
        assert!(!same("ok k", "ok b", true));
        assert!(!same("ok k 5", "ok k 5 N/m", true));
        assert!(same("commit 0123456789ab-dirty, x", "commit COMMIT, x", true));
        assert!(!same("commit 0123456789, x", "commit COMMIT, x", true));
        assert!(same("ok status sign test, fault none", "ok status arming, fault none", true));
        assert!(same("ok status ramping in, fault none", "ok status arming, fault none", true));
        assert!(!same("ok status armed, fault none", "ok status arming, fault none", true));
    }
}
