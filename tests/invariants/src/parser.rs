//! Compares the console's commands and numbers with the standard library.

use proptest::prelude::*;
use zwidth::{
    console::{Command, Decimal, LINE_MAX, Line, LineReader, ParseError, REPLY_MAX, Text, parse, usages},
    device::designs::is_design_name,
    velocity::EstimatorName,
};

/// The number that the console reads from `k TEXT`.
fn number(text: &str) -> Option<f64> {
    match parse(format!("k {text}").as_bytes()) {
        Ok(Command::Stiffness(value)) => Some(value),
        Ok(other) => panic!("{text} became {other:?}"),
        Err(_) => None,
    }
}

/// Whether the documentation allows a text as a number. The text has an optional sign, and digits with at most one
/// point. It has at most 15 significant digits, and at most three digits of exponent. If the number is written as a
/// whole number times a power of ten, the exponent is at most 22.
fn is_offered(text: &str) -> bool {
    let unsigned = text.strip_prefix(['+', '-']).unwrap_or(text);
    let lower = unsigned.to_ascii_lowercase();
    let (mantissa, exponent) = lower.split_once('e').map_or((&*lower, "0"), |(m, e)| (m, e));
    let digits = exponent.strip_prefix(['+', '-']).unwrap_or(exponent);
    let is_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if !(1..=3).contains(&digits.len()) || !is_digits(digits) {
        return false;
    }
    let (whole, part) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let all = format!("{whole}{part}");
    if all.is_empty() || !is_digits(&all) {
        return false;
    }
    let significant = all.trim_start_matches('0');
    let power = exponent.parse::<i64>().unwrap() - part.len() as i64;
    significant.len() <= 15 && (significant.is_empty() || power.abs() <= 22)
}

/// Texts that are numbers, almost numbers, or not numbers.
fn text() -> impl Strategy<Value = String> {
    prop_oneof![
        4 => "[+-]?[0-9]{0,9}(\\.[0-9]{0,9})?([eE][+-]?[0-9]{1,3})?",
        2 => "[+-]?0{0,5}[0-9]{10,17}(\\.[0-9]{0,4})?([eE][+-]?[0-9]{1,2})?",
        2 => "[0-9eE.+-]{1,12}",
        1 => any::<f64>().prop_map(|value| value.to_string()),
        1 => any::<f64>().prop_map(|value| format!("{value:e}")),
        1 => any::<i64>().prop_map(|value| value.to_string()),
        1 => prop::sample::select(vec!["nan", "inf", "-inf", "infinity", "0x10", "1_000", "1e", "e1"])
            .prop_map(str::to_owned),
    ]
}

crate::properties! {
    /// A number that is read equals the standard library's f64 bit for bit, except for the sign of 0. Every number that
    /// the documentation allows is read.
    numbers(4000, text in text()) {
        let expected = text.parse::<f64>().ok().filter(|_| is_offered(&text));
        let read = number(&text);
        if text.is_empty() {
            assert_eq!(read, None);
        } else {
            assert_eq!(read, expected, "{text:?}");
        }
    }

    /// A printed number is within half a unit of its twelfth digit. The printed form of a number with twelve digits is
    /// read as the same number.
    shown(4000, (digits, exponent, negative, any) in (
        1u64..1_000_000_000_000,
        -21i32..=10,
        any::<bool>(),
        any::<f64>(),
    )) {
        let sign = if negative { "-" } else { "" };
        let value: f64 = format!("{sign}{digits}e{exponent}").parse().unwrap();
        let text = Decimal(value).to_string();
        assert_eq!(text.parse::<f64>(), Ok(value), "{text}");
        if is_offered(&text) {
            assert_eq!(number(&text), Some(value), "{text}");
        }
        let normal = any.is_finite() && any.abs() > 1e-300;
        let back: f64 = Decimal(any).to_string().to_lowercase().parse().unwrap();
        assert!(!normal || (back / any - 1.0).abs() < 5.1e-12, "{any} became {back}");
    }

    /// A command is a name from the help with its values. Its letters may have either case, and any blanks are allowed.
    /// Nothing else is read as a command. Every error message fits a line.
    commands(3000, (place, words, upper, blank) in (
        any::<prop::sample::Index>(),
        prop::collection::vec(prop_oneof![
            text(),
            "[a-z0-9+-]{1,12}".prop_map(String::from),
            prop::sample::select(vec!["on", "off", "+", "-", "envelope", "7"]).prop_map(str::to_owned),
            prop::sample::select(EstimatorName::ALL).prop_map(|name| name.text().to_owned()),
        ], 0..3),
        any::<bool>(),
        "[ \t]{1,3}",
    )) {
        let all: Vec<&str> = usages().collect();
        let usage = all[place.index(all.len())];
        let (name, wanted) = usage.split_once(' ').map_or((usage, None), |(name, wanted)| (name, Some(wanted)));
        let words: Vec<String> = words.into_iter().filter(|word| !word.is_empty()).collect();
        let typed = if upper { name.to_uppercase() } else { name.to_owned() };
        let line = std::iter::once(typed).chain(words.iter().cloned()).collect::<Vec<_>>().join(&blank);
        let is_number = wanted.is_some_and(|wanted| wanted.bytes().any(|byte| byte.is_ascii_uppercase()));
        let expected = match (wanted, words.as_slice()) {
            (None, []) => true,
            (None, _) | (Some(_), []) | (Some(_), [_, _, ..]) => false,
            (Some("NAME"), [word]) if name == "design" => is_design_name(word),
            (Some("NAME"), [word]) => EstimatorName::ALL.iter().any(|name| name.text().eq_ignore_ascii_case(word)),
            (Some(_), [word]) if is_number => is_offered(word) && word.parse::<f64>().is_ok(),
            (Some(choice), [word]) => choice.split('|').any(|known| known.eq_ignore_ascii_case(word)),
        };
        let read = parse(line.as_bytes());
        assert_eq!(read.is_ok(), expected, "{line:?}: {read:?}");
        if let Err(error) = read {
            let text = Text::<REPLY_MAX>::of(error);
            assert!(!text.as_str().contains(['\n', '\r', '~']));
        }
    }

    /// The console splits any bytes into lines as the standard library does. A line that is too long is refused once.
    /// Blank lines and bytes of 0 are ignored.
    lines(150, pieces in prop::collection::vec(
        prop_oneof![
            2 => prop::collection::vec(any::<u8>(), 0..20),
            // Lines near the longest accepted length.
            2 => (LINE_MAX - 3..LINE_MAX + 4).prop_map(|length| vec![b'x'; length]),
            1 => (0..2 * LINE_MAX).prop_map(|length| vec![b' '; length]),
            4 => prop::sample::select(vec!["\n", "\r", "\r\n"]).prop_map(|end| end.as_bytes().to_vec()),
        ],
        0..40,
    )) {
        let bytes = pieces.concat();
        let mut reader = LineReader::<LINE_MAX>::new();
        let mut read = Vec::new();
        for byte in &bytes {
            match reader.push(*byte) {
                None => {}
                Some(Line::TooLong) => read.push(Err(ParseError::TooLong)),
                Some(Line::Text(text)) => read.push(Ok(text.to_vec())),
            }
        }
        let bytes: Vec<u8> = bytes.into_iter().filter(|byte| *byte != 0).collect();
        let mut pieces: Vec<&[u8]> = bytes.split(|byte| matches!(byte, b'\n' | b'\r')).collect();
        pieces.pop(); // not ended
        let expected: Vec<_> = pieces
            .into_iter()
            .filter(|line| line.len() > LINE_MAX || !line.iter().all(u8::is_ascii_whitespace))
            .map(|line| if line.len() > LINE_MAX { Err(ParseError::TooLong) } else { Ok(line.to_vec()) })
            .collect();
        assert_eq!(read, expected);
    }
}
