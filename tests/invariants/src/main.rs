//! `cargo invariants [--minutes M | --batches N | --batch N] [--seed S] [--only NAME] [--list]`

use std::{process::ExitCode, time::Duration};

use invariants::campaign::{Campaign, Extent, summary};

const USAGE: &str = "\
cargo invariants [--minutes M | --batches N | --batch N] [--seed S] [--only NAME] [--list]

  --minutes M  time, 0 to 10000; 1 if nothing is said; every property gets one batch at least
  --batches N  the first N batches of each instead, the same cases on every machine
  --batch N    this batch of each only
  --seed S     the cases follow from it; drawn from the clock if nothing is said
  --only NAME  properties whose name has that in it
  --list       names and what they state";

/// Exit code after a signal.
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
    let (mut extent, mut only, mut list) = (None::<(&str, Extent)>, String::new(), false);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        let mut set = |name, to| match extent.replace((name, to)) {
            Some((other, _)) => Err(format!("{other} and {name} are not for one run")),
            None => Ok(()),
        };
        match word.as_str() {
            "--minutes" => set("--minutes", Extent::Time(minutes(&value()?)?))?,
            "--batches" => set("--batches", Extent::Batches(whole("--batches", &value()?)?))?,
            "--batch" => set("--batch", Extent::Batch(whole("--batch", &value()?)?))?,
            "--seed" => seed = whole("--seed", &value()?)?,
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
    let (_, extent) = extent.unwrap_or(("", Extent::Time(Duration::from_mins(1))));
    println!("seed {seed}, {} properties, {}", properties.len(), told(extent));
    let holds = Campaign { extent, seed, properties }.run();
    print!("{}", summary());
    Ok(holds)
}

fn told(extent: Extent) -> String {
    match extent {
        Extent::Time(lasts) => format!("{} minutes", lasts.as_secs_f64() / 60.0),
        Extent::Batches(most) => format!("{most} batches of each"),
        Extent::Batch(only) => format!("batch {only} of each"),
    }
}

fn minutes(text: &str) -> Result<Duration, String> {
    let allowed = |minutes: &f64| (0.0..=10_000.0).contains(minutes);
    let minutes: Option<f64> = text.parse().ok().filter(allowed);
    let minutes = minutes.ok_or(format!("--minutes is {text}, allowed 0 to 10000"))?;
    Ok(Duration::from_secs_f64(60.0 * minutes))
}

fn whole(name: &str, text: &str) -> Result<u64, String> {
    text.parse()
        .map_err(|_| format!("{name} is {text}, allowed a whole number from 0 to {}", u64::MAX))
}
