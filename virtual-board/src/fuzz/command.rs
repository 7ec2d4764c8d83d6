//! Lines as the console's page says that they are read.

/// A command that was understood.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    pub name: &'static str,
    pub number: f64,
    pub word: String,
}

/// What stands behind a command's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    Nothing,
    Number,
    Words(&'static [&'static str]),
    Estimator,
    Design,
}

/// Every command in the order of `help`: its use.
pub const COMMANDS: [(&str, Form); 44] = {
    use Form::{Design, Estimator, Nothing, Number, Words};
    [
        ("help", Nothing),
        ("version", Nothing),
        ("status", Nothing),
        ("get", Nothing),
        ("zero", Nothing),
        ("arm", Nothing),
        ("disarm", Nothing),
        ("k N_PER_M", Number),
        ("b N_S_PER_M", Number),
        ("wall METRES", Number),
        ("cutoff HZ", Number),
        ("tuning VALUE", Number),
        ("tuning2 VALUE", Number),
        ("estimator NAME", Estimator),
        ("designs", Nothing),
        ("design NAME", Design),
        ("period SAMPLES", Number),
        ("push NEWTONS", Number),
        ("hit", Nothing),
        ("pulses NEWTONS", Number),
        ("walk", Nothing),
        ("stop", Nothing),
        ("unlock envelope", Words(&["envelope"])),
        ("stream on|off", Words(&["on", "off"])),
        ("save", Nothing),
        ("load", Nothing),
        ("faults", Nothing),
        ("clear", Nothing),
        ("calibrate PERCENT", Number),
        ("fullscale NEWTONS", Number),
        ("start METRES", Number),
        ("settle SECONDS", Number),
        ("window SECONDS", Number),
        ("rms METRES", Number),
        ("kstart N_PER_M", Number),
        ("kstep N_PER_M", Number),
        ("kmax N_PER_M", Number),
        ("bstart N_S_PER_M", Number),
        ("bstep N_S_PER_M", Number),
        ("bmax N_S_PER_M", Number),
        ("motor +|-", Words(&["+", "-"])),
        ("encoder +|-", Words(&["+", "-"])),
        ("alive MS", Number),
        ("selftest", Nothing),
    ]
};

/// Longest line, bytes.
const LONGEST: usize = 64;

/// What `help` says.
pub fn help() -> String {
    format!("ok {}", COMMANDS.map(|(usage, _)| usage).join(", "))
}

/// Name of a command.
pub fn name_of(usage: &'static str) -> &'static str {
    usage.split(' ').next().unwrap_or(usage)
}

/// Reads one line.
///
/// # Errors
/// What the reply says.
pub fn parse(line: &[u8]) -> Result<Command, String> {
    if line.len() > LONGEST {
        return Err(format!("line too long: at most {LONGEST} bytes"));
    }
    let words: Vec<&[u8]> =
        line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).collect();
    let is = |word: &[u8], known: &str| word.eq_ignore_ascii_case(known.as_bytes());
    let (usage, form) = COMMANDS
        .into_iter()
        .find(|(usage, _)| words.first().is_some_and(|word| is(word, name_of(usage))))
        .ok_or("unknown command: help lists them")?;
    let mut command = Command { name: name_of(usage), number: 0.0, word: String::new() };
    let taken = if form == Form::Nothing { 1 } else { 2 };
    let behind = words.get(1).copied();
    if taken == 2 {
        let word = behind.ok_or_else(|| format!("something is missing: {usage}"))?;
        match form {
            Form::Nothing => {}
            Form::Number => {
                command.number = number(word).ok_or_else(|| {
                    format!(
                        "not a number of at most 15 digits such as 2000, 0.07 or 1.5e3: {usage}"
                    )
                })?;
            }
            Form::Words(known) => {
                let found = known.iter().find(|known| is(word, known));
                command.word = found.ok_or_else(|| format!("unknown word: {usage}"))?.to_string();
            }
            Form::Estimator => {
                command.word = String::from_utf8_lossy(word).into_owned();
                if super::settings::Settings::estimator_named(&command.word).is_none() {
                    let known = super::settings::Settings::estimators();
                    return Err(format!("unknown estimator, allowed {known}"));
                }
            }
            Form::Design => {
                let allowed = |byte: &u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
                if word.len() > 16 || !word.iter().all(allowed) {
                    return Err("no name of a design: designs lists them".into());
                }
            }
        }
    }
    if words.len() > taken {
        return Err(format!("too many words: {usage}"));
    }
    Ok(command)
}

/// At most 15 digits that count, and a power of ten within 22 of them as a whole number.
fn number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    let plain = text.strip_prefix(['+', '-']).unwrap_or(text);
    let (digits, exponent) = match plain.split_once(['e', 'E']) {
        Some((digits, exponent)) => {
            let unsigned = exponent.strip_prefix(['+', '-']).unwrap_or(exponent);
            let fits =
                (1..=3).contains(&unsigned.len()) && unsigned.bytes().all(|b| b.is_ascii_digit());
            (digits, exponent.parse::<i32>().ok().filter(|_| fits)?)
        }
        None => (plain, 0),
    };
    let (whole, part) = digits.split_once('.').unwrap_or((digits, ""));
    let all = format!("{whole}{part}");
    if all.is_empty() || !all.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let counting = all.trim_start_matches('0');
    if counting.is_empty() {
        return Some(0.0);
    }
    let power = exponent - i32::try_from(part.len()).ok()?;
    if counting.len() > 15 || power.abs() > 22 {
        return None;
    }
    text.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_as_the_page_says() {
        let number = |line: &str| parse(line.as_bytes()).map(|command| command.number).ok();
        assert_eq!(number("k 2000"), Some(2000.0));
        assert_eq!(number(" WALL\t-7.5E-2 "), Some(-0.075));
        assert_eq!(number("k .5"), Some(0.5));
        assert_eq!(number("k 0e999"), Some(0.0));
        for bad in [
            "k",
            "k nan",
            "k inf",
            "k 1e",
            "k 1e23",
            "k 1234567890123456",
            "k 5 5",
            "kk 5",
            "k --1",
        ] {
            assert_eq!(number(bad), None, "{bad}");
        }
        assert_eq!(parse(b"stream ON").unwrap().word, "on");
        assert_eq!(
            parse(b"estimator nonsense").unwrap_err().split(',').next(),
            Some("unknown estimator")
        );
        assert_eq!(parse(&[b'x'; 65]).unwrap_err(), "line too long: at most 64 bytes");
    }
}
