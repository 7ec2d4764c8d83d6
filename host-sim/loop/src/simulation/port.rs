//! The energy that wall and hand exchange during a hit. The port is where wall and hand meet. A force of the wall is
//! included from the sample at which the force acts. The motion is computed from the counts.

use zwidth::{Design, port::PortEnergy, units::Position};

use super::{Block, Output, Sample, controller::ControllerOutput, passive};

/// Measures the energy at the port. It also stores the wall forces that do not act yet.
#[derive(Clone, Debug)]
pub struct PortWatch {
    port: PortEnergy,
    /// Forces that do not act yet. Each entry has the sample at which the force acts, the force, and whether the handle
    /// is in contact.
    pending: Vec<(u64, i64, bool)>,
    /// Number of whole samples from an output until its force acts.
    latency: u64,
    surface: i32,
    /// Energy of one LSB of force times one count, in J.
    unit_j: f64,
    /// Number of outputs in contact, and how many of these outputs the passivity controller changed.
    outputs: [u32; 2],
    /// Two sums of magnitudes over the outputs in contact: the wall's force before the passivity controller, and the
    /// force that this controller withheld.
    forces: [f64; 2],
}

/// Energy that wall and hand exchanged in a hit, in J.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PortReport {
    /// Energy that the wall has taken in the last contact in J. Negative if the wall has given energy.
    pub taken_j: f64,
    /// Largest net energy that the wall has given in a contact, at any time, in J.
    pub given_j: f64,
    /// Outputs that the passivity controller changed, as a fraction of the outputs in contact.
    pub limited_fraction: f64,
    /// Withheld force as a fraction of the wall's force. Both forces are summed over the outputs in contact.
    pub withheld_fraction: f64,
}

impl PortWatch {
    /// The port, for a handle at rest at `count`.
    pub fn new(design: &Design, latency: u32, surface: i32, count: i32) -> Self {
        Self {
            port: PortEnergy::new(Position::from_counts(count)),
            pending: vec![],
            latency: latency.into(),
            surface,
            unit_j: design.full_scale_n / passive::FULL_SCALE * design.resolution_m,
            outputs: [0; 2],
            forces: [0.0; 2],
        }
    }

    pub fn block(&mut self, block: &Block) {
        self.take(block.index(), block.counts(), block.outputs());
    }

    pub fn sample(&mut self, sample: &Sample) {
        let output = sample.rendered.map(|rendered| Output { place: 0, rendered });
        self.take(sample.index, &[sample.count], output.as_slice());
    }

    fn take(&mut self, index: u64, counts: &[i32], outputs: &[Output]) {
        for Output { place, rendered } in outputs {
            let Some(count) = counts.get(*place) else { continue };
            self.rendered(index + *place as u64, *count, rendered);
        }
        let mut acted = 0;
        for (acts, wall, contact) in &self.pending {
            let place = usize::try_from(acts - index).unwrap_or(usize::MAX);
            let Some(count) = counts.get(place) else { break };
            self.port.acts(*wall, *contact, Position::from_counts(*count));
            acted += 1;
        }
        self.pending.drain(..acted);
    }

    fn rendered(&mut self, index: u64, count: i32, rendered: &ControllerOutput) {
        let wall = passive::bits(rendered.push - rendered.force);
        let contact = count > self.surface;
        self.pending.push((index + self.latency, wall, contact));
        if contact {
            let withheld = rendered.withheld;
            self.outputs[0] += 1;
            self.outputs[1] += u32::from(withheld != 0.0);
            self.forces[0] += (rendered.push - rendered.force + withheld).abs();
            self.forces[1] += withheld.abs();
        }
    }

    /// The report up to the sample that has this count.
    pub fn report(&self, count: i32) -> PortReport {
        let mut port = self.port;
        port.moved(Position::from_counts(count));
        let share = |[of, part]: [f64; 2]| if of > 0.0 { part / of } else { 0.0 };
        PortReport {
            taken_j: self.joules(port.energy()),
            given_j: self.joules(port.given()),
            limited_fraction: share(self.outputs.map(f64::from)),
            withheld_fraction: share(self.forces),
        }
    }

    fn joules(&self, energy: i64) -> f64 {
        energy as f64 * self.unit_j
    }
}
