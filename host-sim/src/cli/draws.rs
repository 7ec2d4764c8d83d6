//! Options for the probability that a wall is stable.

use clap::Args;

use super::shared::Typed;

use crate::{error::Error, scene::NamedScene, study::probability::Draws};

/// Default number of starts for the scene's own device, and for each drawn device.
const STARTS: [u32; 2] = [16, 1];

/// Options for the probability that a wall is stable: the share of starts and devices at which it is stable.
#[derive(Clone, Debug, Args)]
pub struct DrawArgs {
    /// Probability that each wall is stable. It is the share of starts, spread over one count, at which the wall is
    /// stable. With --uncertain, it is the share of starts and devices.
    #[arg(long)]
    probability: bool,
    /// With --probability: draw this number of devices from the scene's [uncertainty].
    #[arg(long, value_name = "N", requires = "probability", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    uncertain: Option<u32>,
    /// With --probability: number of starts for each device [default: 16; with --uncertain 1].
    #[arg(long, value_name = "N", requires = "probability", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    starts_each: Option<u32>,
}

impl DrawArgs {
    fn starts(&self) -> u32 {
        self.starts_each.unwrap_or(STARTS[usize::from(self.uncertain.is_some())])
    }

    /// The draws that the options ask for. `None` without `--probability`.
    pub fn of(&self, scene: &NamedScene) -> Result<Option<Draws>, Error> {
        let draws = || Draws::new(&scene.scene, self.uncertain.unwrap_or(0), self.starts());
        self.probability.then(draws).transpose().map_err(|error| error.of(&scene.name))
    }

    /// The options, as text of a command line.
    pub fn as_typed(&self) -> String {
        if !self.probability {
            return String::new();
        }
        let typed = Typed(" --probability".into()).maybe("uncertain", self.uncertain);
        typed.with("starts-each", self.starts()).0
    }
}
