//! `--probe`: a real board behind a debug probe. If the program was built without the feature `probe`, the option
//! prints how to build with it.

#[cfg(feature = "probe")]
mod attached;
#[cfg(feature = "probe")]
mod found;

use clap::Args;
use host_sim::error::Error;
#[cfg(feature = "probe")]
use virtual_board::{board::Board, elf::Elf, link::Link};

/// Why the force has to be off before the probe attaches.
#[cfg(any(feature = "probe", test))]
const WHY: &str = "attaching halts the board's core for a moment, and nobody can see before whether its force is on \
                   (then it is fault 32, and the handle is let go)";
#[cfg(any(feature = "probe", test))]
const HOW: &str = "open the wired stop, or see that the board is disarmed";

/// Options for a debug probe.
#[derive(Args)]
pub struct Options {
    /// A real board behind a debug probe (ST-LINK, J-Link, CMSIS-DAP 2), in place of the virtual one. The value selects
    /// one of several probes. Attaching halts the board for a moment, so its force has to be off.
    #[arg(
        long,
        value_name = "VID:PID[:SERIAL]",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "",
        conflicts_with = "rtt_tcp"
    )]
    probe: Option<String>,
    /// The chip by probe-rs' name [default: the board's].
    #[arg(long, value_name = "NAME", requires = "probe")]
    chip: Option<String>,
    /// Clock of the probe's wires in kHz [default: the probe's].
    #[arg(long, value_name = "KHZ", requires = "probe", value_parser = clap::value_parser!(u32).range(1..))]
    speed: Option<u32>,
    /// Confirms that the wired stop is open or the board is disarmed, so that no question is asked.
    #[arg(long, requires = "probe")]
    force_is_off: bool,
}

impl Options {
    /// Whether a probe is requested. Refuses a scene name that has the form of a probe's selector.
    ///
    /// # Errors
    /// The scene's name has this form, or this program was built without probes.
    pub fn is_wanted(&self, scene: &str) -> Result<bool, Error> {
        if self.probe.is_none() {
            return Ok(false);
        }
        if !cfg!(feature = "probe") {
            return Err(Error::input(
                "--probe: this program was built without debug probes; `cargo live-probe --probe` builds it with them",
            ));
        }
        let is_hex = |word: &str| word.len() == 4 && u16::from_str_radix(word, 16).is_ok();
        let mut words = scene.split(':');
        if words.next().is_some_and(is_hex) && words.next().is_some_and(is_hex) {
            return Err(Error::Input(format!(
                "SCENE is {scene}, which looks like a probe: --probe={scene}, with `=`"
            )));
        }
        Ok(true)
    }

    /// Connects to the board behind the probe. The force must be off. `elf` is called when the probe has been found.
    ///
    /// # Errors
    /// There is no probe, or there are several; the force may be on; or no board with this firmware answers.
    #[cfg(feature = "probe")]
    pub fn connect(
        &self,
        board: Board,
        elf: impl FnOnce() -> Result<Elf, Error>,
    ) -> Result<(Box<dyn Link>, Elf), Error> {
        use host_sim::output::terminal::note;
        use probe_rs::probe::list::Lister;

        let bad = |text: String| Error::Input(format!("--probe: {text}"));
        let chip = self.chip.as_deref().unwrap_or(board.part);
        let target = attached::target(chip).map_err(bad)?;
        let info = found::one(&Lister::new(), self.probe.as_deref().unwrap_or("")).map_err(bad)?;
        let elf = elf()?;
        if !self.force_is_off {
            let stdin = std::io::stdin();
            let is_terminal = std::io::IsTerminal::is_terminal(&stdin);
            if is_terminal {
                note(&format!("{WHY}: {HOW}, then type off"));
            }
            is_off(is_terminal, stdin.lock())?;
        }
        let name = found::name(&info);
        let probe = found::open(&info, self.speed).map_err(bad)?;
        let probe = attached::Attached::to(probe, target)
            .map_err(|error| bad(format!("{name}: no {chip}: {error}")))?;
        let (link, met) = virtual_board::link::ProbeLink::attach(probe, &elf)
            .map_err(|error| bad(format!("{name}: {error}")))?;
        note(&format!("{name}: {met}"));
        Ok((Box::new(link), elf))
    }
}

/// Checks a person's answer that the force is off. The question is asked each time, because the state may have changed.
#[cfg(any(feature = "probe", test))]
fn is_off(is_terminal: bool, mut answer: impl std::io::BufRead) -> Result<(), Error> {
    if !is_terminal {
        return Err(Error::Input(format!(
            "--probe: {WHY}: {HOW}, then give --force-is-off; nothing was attached"
        )));
    }
    let mut line = String::new();
    let _ = answer.read_line(&mut line); // an unreadable line counts as no answer
    if line.trim() == "off" {
        return Ok(());
    }
    Err(Error::Input(format!("--probe: the answer was not `off`; nothing was attached. {HOW}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        scene: Option<String>,
        #[arg(long)]
        rtt_tcp: Option<String>,
        #[command(flatten)]
        probe: Options,
    }

    fn parse(words: &str) -> Result<Cli, String> {
        Cli::try_parse_from(words.split(' ')).map_err(|error| error.to_string())
    }

    #[test]
    fn only_the_word_off_on_a_terminal_is_an_answer() {
        assert!(is_off(true, &b"off\n"[..]).is_ok());
        for answer in ["", "\n", "y\n", "yes\n", "on\n", "offf\n", "OFF\n"] {
            let error = is_off(true, answer.as_bytes()).unwrap_err().to_string();
            assert!(error.contains("open the wired stop"), "{error}");
        }
        let error = is_off(false, &b"off\n"[..]).unwrap_err().to_string();
        for part in ["open the wired stop", "--force-is-off", "fault 32", "nothing was attached"] {
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn options_that_do_not_go_together_are_refused() {
        for (words, said) in [
            ("live --probe --rtt-tcp localhost:1", "'--rtt-tcp <RTT_TCP>'"),
            ("live --chip STM32F446RETx", "--probe"),
            ("live --force-is-off", "--probe"),
            ("live --probe --speed 0", "0 is not in 1.."),
        ] {
            let error = parse(words).err().unwrap();
            assert!(error.contains(said), "{error}");
        }
        let cli = parse("live --probe=0483:374b scene").unwrap();
        assert_eq!(
            (cli.probe.probe.as_deref(), cli.scene.as_deref()),
            (Some("0483:374b"), Some("scene"))
        );
        let cli = parse("live --probe scene").unwrap();
        assert_eq!((cli.probe.probe.as_deref(), cli.scene.as_deref()), (Some(""), Some("scene")));
        assert!(!parse("live scene").unwrap().probe.is_wanted("0483:374b").unwrap());
        let error = cli.probe.is_wanted("0483:374b:0669FF").unwrap_err().to_string();
        if cfg!(feature = "probe") {
            assert!(error.contains("--probe=0483:374b:0669FF"), "{error}");
            assert!(cli.probe.is_wanted("paper-1um").unwrap());
            assert!(cli.probe.is_wanted("a:b").unwrap());
        } else {
            assert!(error.contains("cargo live-probe --probe"), "{error}");
        }
    }
}
