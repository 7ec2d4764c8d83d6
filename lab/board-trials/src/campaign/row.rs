//! A named fault and its time limit.

use virtual_board::{elf::Elf, session::Failed, world::World};

use super::situation::Situation;

/// Time limit of a fault that must be found with any motion of the handle, in s. The limit includes one sample of the
/// simulation.
pub const SOON_S: f64 = 3e-3;
pub(super) const GRID_S: f64 = 1e-4;

type Begin = dyn Fn(&Elf, &mut World<'_>) -> Result<u64, Failed> + Send + Sync;
/// A test that damages stored data. It returns the number of cases that it tried, or the first error.
type Keeps = fn(&mut World<'_>) -> Result<usize, Failed>;

pub struct Row {
    /// Name in reports, unique among the rows.
    pub name: String,
    pub begin: Box<Begin>,
    /// Longest allowed time from the fault until the force is off, in s.
    pub limit_s: f64,
    /// The reason why the fault is never found. The first entry is for free motion, the second for contact.
    pub never: [Option<&'static str>; 2],
    /// Whether the force is off before the fault.
    pub from_off: bool,
    /// Whether the fault is injected in free motion only. In contact, the data that the fault damages does not exist.
    pub only_free: bool,
    /// Whether the fault is not injected at the full force.
    pub not_full: bool,
    /// A test that is run in place of `begin`. It damages stored data many times, with the force off.
    pub keeps: Option<Keeps>,
}

impl Row {
    pub fn of(
        name: impl Into<String>,
        limit_s: f64,
        begin: impl Fn(&Elf, &mut World<'_>) -> Result<u64, Failed> + Send + Sync + 'static,
    ) -> Self {
        let begin = Box::new(begin);
        Self {
            name: name.into(),
            begin,
            limit_s,
            never: [None; 2],
            from_off: false,
            only_free: false,
            not_full: false,
            keeps: None,
        }
    }

    /// A row whose fault begins at the moment when it is caused.
    pub fn at_once(
        name: impl Into<String>,
        limit_s: f64,
        cause: impl Fn(&Elf, &mut World<'_>) -> Result<(), Failed> + Send + Sync + 'static,
    ) -> Self {
        let begin = move |elf: &Elf, world: &mut World<'_>| {
            cause(elf, world)?;
            Ok(world.powered.mcu.now())
        };
        Self::of(name, limit_s, begin)
    }

    /// A row that starts with the force off, and the force must stay off. Afterwards the stored data must either equal
    /// what was saved or be missing.
    pub fn keeping(name: &str, keeps: Keeps) -> Self {
        Self { from_off: true, keeps: Some(keeps), ..Self::at_once(name, SOON_S, |_, _| Ok(())) }
    }

    pub fn only_free(self) -> Self {
        Self { only_free: true, ..self }
    }

    /// Marks a row that is not run at the full force, because its fault would increase the force.
    pub fn not_full(self) -> Self {
        Self { not_full: true, ..self }
    }

    /// Stores the reason why the fault cannot be found in free motion.
    pub fn never_free(mut self, why: &'static str) -> Self {
        self.never[0] = Some(why);
        self
    }

    /// Stores the reason why the fault cannot be found in contact.
    pub fn never_in_contact(mut self, why: &'static str) -> Self {
        self.never[1] = Some(why);
        self
    }

    /// The reason why the fault cannot be found in this situation, if there is one.
    pub fn reason(&self, situation: Situation) -> Option<&'static str> {
        self.never[usize::from(!situation.is_free())]
    }

    /// Whether the row is run in this situation. At the full force, only rows with the limit [`SOON_S`] are run.
    pub fn is_in(&self, situation: Situation) -> bool {
        let soon = self.limit_s <= SOON_S + GRID_S && self.never[0].is_none();
        match situation {
            Situation::Free => true,
            Situation::Contact => !self.from_off && !self.only_free,
            Situation::Full => !self.from_off && !self.not_full && soon,
            Situation::Return => false,
        }
    }

    /// Name of the row on the command line, with dashes between the words.
    pub fn slug(&self) -> String {
        slug(&self.name)
    }
}

/// The name in lower case, with a dash between its groups of letters and digits.
pub fn slug(name: &str) -> String {
    let lower = name.to_lowercase();
    let words = lower.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("-")
}
