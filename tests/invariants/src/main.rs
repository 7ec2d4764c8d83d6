//! `cargo invariants [--minutes M] [--seed S] [--only NAME] [--batch N] [--list]`

use std::{process::ExitCode, time::Duration};

use invariants::campaign::{Campaign, summary};

const USAGE: &str = "\
cargo invariants [--minutes M] [--seed S] [--only NAME] [--batch N] [--list]

  --minutes M  time, 0 to 10000; 1 if nothing is said; every property gets one batch at least
  --seed S     the cases follow from it; drawn from the clock if nothing is said
  --only NAME  properties whose name has that in it
  --batch N    this batch of each only
  --list       names and what they state";

/// Ended by a signal.
const INTERRUPTED: i32 = 130;

fn main() -> ExitCode {
    match command() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(text) => {
            eprintln!("error: {text}");
            ExitCode::from(2)
        }
    }
}

fn command() -> Result<bool, String> {
    let clock = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let mut seed = clock.map_or(1, |since| since.as_secs());
    let (mut minutes, mut only, mut batch, mut list) = (1.0, String::new(), None, false);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "--minutes" => {
                let text = value()?;
                minutes = text
                    .parse()
                    .ok()
                    .filter(|minutes| (0.0..=10_000.0).contains(minutes))
                    .ok_or(format!("--minutes is {text}, allowed 0 to 10000"))?;
            }
            "--seed" => seed = whole("--seed", &value()?)?,
            "--batch" => batch = Some(whole("--batch", &value()?)?),
            "--only" => only = value()?,
            "--list" => list = true,
            "--help" | "-h" => {
                println!("{USAGE}");
                return Ok(true);
            }
            _ => return Err(format!("{word} is no option: cargo invariants --help lists them")),
        }
    }
    let properties: Vec<_> =
        invariants::all().filter(|property| property.title().contains(&only)).collect();
    if properties.is_empty() {
        return Err(format!("--only is {only}, which is in no name: --list has them"));
    }
    if list {
        for property in properties {
            println!("{}:{}", property.title(), property.states);
        }
        return Ok(true);
    }
    ctrlc::set_handler(|| {
        println!("{}interrupted", summary());
        std::process::exit(INTERRUPTED);
    })
    .map_err(|error| format!("cannot watch for Ctrl-C: {error}"))?;
    println!("seed {seed}, {} properties, {minutes} minutes", properties.len());
    let lasts = Duration::from_secs_f64(60.0 * minutes);
    let holds = Campaign { lasts, seed, properties, batch }.run();
    print!("{}", summary());
    Ok(holds)
}

fn whole(name: &str, text: &str) -> Result<u64, String> {
    text.parse()
        .map_err(|_| format!("{name} is {text}, allowed a whole number from 0 to {}", u64::MAX))
}
