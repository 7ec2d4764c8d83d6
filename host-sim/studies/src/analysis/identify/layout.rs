//! The parameters of a fit, and their indices in the vector of values.

use nalgebra::DVector;

use self::Parameter::{
    CogCosine, CogCycles, CogSine, Constant, Cosine, Cycles, Damping, Fall, Friction, Gain, Lag,
    Latency, Mass, Rise, Second, Sine, Stiffness,
};

/// Indices of the two parameters that every fit has.
pub(super) const MASS: usize = 0;
pub(super) const DAMPING: usize = 1;
/// Parameters of the device, in the order of the vector of values. In the vector, the position and the speed of each
/// record follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Parameter {
    Mass,
    Damping,
    Stiffness,
    /// The force `k (x0 - reference)`. If x0 is known or there is no spring, it is the offset force.
    Constant,
    Gain,
    Latency,
    /// Force of Coulomb friction, in N.
    Friction,
    /// Time constant of the amplifier, in s.
    Lag,
    /// Static friction minus Coulomb friction, in N.
    Rise,
    /// Speed over which the friction falls from static to Coulomb friction, in m/s.
    Fall,
    /// The encoder's error that repeats once per cycle: its sine part and cosine part at the reference, in m.
    Sine,
    Cosine,
    /// Cycles of the encoder's error per metre.
    Cycles,
    /// Amplitude of the encoder's error that repeats twice per cycle, in m.
    Second,
    /// Cogging: its sine part and cosine part at the reference in N, and the cogs per metre.
    CogSine,
    CogCosine,
    CogCycles,
}

/// All parameters, in the order of the vector.
pub(super) const PARAMETERS: [Parameter; 17] = [
    Mass, Damping, Stiffness, Constant, Gain, Latency, Friction, Lag, Rise, Fall, Sine, Cosine,
    Cycles, Second, CogSine, CogCosine, CogCycles,
];

impl Parameter {
    /// Name of the parameter in error messages.
    pub(super) fn name(self) -> &'static str {
        match self {
            Mass => "mass",
            Damping => "damping",
            Stiffness => "stiffness",
            Constant => "rest position",
            Gain => "force gain",
            Latency => "latency",
            Friction => "friction",
            Lag => "lag of the amplifier",
            Rise => "static friction",
            Fall => "Stribeck speed",
            Sine | Cosine => "encoder error",
            Cycles => "cycle of the encoder error",
            Second => "encoder error twice per cycle",
            CogSine | CogCosine => "cogging",
            CogCycles => "pitch of the cogs",
        }
    }
}

/// Which parameters are fitted, and the values of the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Layout {
    /// Whether the device has a spring. Without a spring, k is 0.
    pub spring: bool,
    /// Rest position in m, measured from the reference; `None` if it is fitted.
    pub rest_m: Option<f64>,
    /// Force per volt in N/V; `None` if it is fitted.
    pub gain: Option<f64>,
    /// Latency in s; `None` if it is fitted.
    pub latency_s: Option<f64>,
    /// Terms in addition to mass, damping and spring.
    pub terms: Included,
    /// Cycles of the encoder's signals per metre; `None` if they are fitted.
    pub cycles_per_m: Option<f64>,
    /// Cogs per metre; `None` if they are fitted.
    pub cogs_per_m: Option<f64>,
    /// Position in m from which all positions of the fit are measured.
    pub reference_m: f64,
    pub records: usize,
    /// The records in which friction holds the handle at the first row. Bit n stands for record n. The first speed of
    /// these records is 0.
    pub resting: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Included {
    pub friction: bool,
    pub lag: bool,
    pub offset: bool,
    pub phase: bool,
    /// Whether the encoder's error also has a part that repeats twice per cycle.
    pub second: bool,
    /// Whether the friction falls with the speed.
    pub stribeck: bool,
    pub cogging: bool,
}

impl Included {
    /// Whether the model is linear, as the paper's model is. The derivatives of a linear model are exact.
    pub(super) fn plain(self) -> bool {
        !(self.friction || self.lag || self.phase || self.cogging)
    }

    /// Whether friction falls with the speed, or there is cogging. With these forces, one step of the motion is not
    /// exact.
    pub(super) fn is_curved(self) -> bool {
        self.stribeck || self.cogging
    }
}

impl Layout {
    fn has(&self, parameter: Parameter) -> bool {
        let Included { friction, lag, offset, phase, second, stribeck, cogging } = self.terms;
        match parameter {
            Mass | Damping => true,
            Stiffness => self.spring,
            Constant => offset || (self.spring && self.rest_m.is_none()),
            Gain => self.gain.is_none(),
            Latency => self.latency_s.is_none(),
            Friction => friction,
            Lag => lag,
            Sine | Cosine => phase,
            Cycles => phase && self.cycles_per_m.is_none(),
            Second => phase && second,
            Rise | Fall => friction && stribeck,
            CogSine | CogCosine => cogging,
            CogCycles => cogging && self.cogs_per_m.is_none(),
        }
    }

    pub(super) fn fitted(&self) -> impl Iterator<Item = Parameter> {
        PARAMETERS.into_iter().filter(|parameter| self.has(*parameter))
    }

    /// Index of a parameter in the vector of values; `None` if it is not fitted.
    pub(super) fn place(&self, parameter: Parameter) -> Option<usize> {
        self.fitted().position(|fitted| fitted == parameter)
    }

    /// Index of a record's first position in the vector of values.
    pub(super) fn position_place(&self, record: usize) -> usize {
        let before = (0..record).filter(|record| self.rests(*record)).count();
        self.fitted().count() + 2 * record - before
    }

    /// Index of a record's first speed in the vector of values; `None` if it is not fitted.
    pub(super) fn speed_place(&self, record: usize) -> Option<usize> {
        (!self.rests(record)).then(|| self.position_place(record) + 1)
    }

    /// Whether friction holds the handle at the first row of a record. This is false if the model has no friction.
    fn rests(&self, record: usize) -> bool {
        self.terms.friction && record < 64 && self.resting >> record & 1 == 1
    }

    fn count(&self) -> usize {
        self.position_place(self.records)
    }

    /// Value of a parameter that is not fitted.
    fn known(&self, parameter: Parameter) -> f64 {
        let known = match parameter {
            Gain => self.gain,
            Latency => self.latency_s,
            Cycles => self.cycles_per_m,
            CogCycles => self.cogs_per_m,
            _ => None,
        };
        known.unwrap_or(0.0)
    }
}

/// Values of the parameters that a [`Layout`] selects. [`within`](Self::within) converts them to another layout.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Values {
    layout: Layout,
    vector: DVector<f64>,
}

impl Values {
    pub(super) fn zeros(layout: Layout) -> Self {
        Self { layout, vector: DVector::zeros(layout.count()) }
    }

    pub(super) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The values in the order of the layout.
    pub(super) fn vector(&self) -> &DVector<f64> {
        &self.vector
    }

    pub(super) fn slice_mut(&mut self) -> &mut [f64] {
        self.vector.as_mut_slice()
    }

    pub(super) fn fitted(&self, parameter: Parameter) -> Option<f64> {
        self.layout.place(parameter).map(|place| self.vector[place])
    }

    /// The value of a parameter, fitted or known. It is 0 if the parameter is not in the model.
    pub(super) fn of(&self, parameter: Parameter) -> f64 {
        self.fitted(parameter).unwrap_or_else(|| self.layout.known(parameter))
    }

    /// Sets a parameter if it is fitted.
    pub(super) fn set(&mut self, parameter: Parameter, value: f64) {
        if let Some(place) = self.layout.place(parameter) {
            self.vector[place] = value;
        }
    }

    /// Position and speed at a record's first fitted row.
    pub(super) fn start(&self, record: usize) -> [f64; 2] {
        let speed = self.layout.speed_place(record).map_or(0.0, |place| self.vector[place]);
        [self.vector[self.layout.position_place(record)], speed]
    }

    /// Sets position and speed at a record's first fitted row. The speed is only set if it is fitted.
    pub(super) fn set_start(&mut self, record: usize, [x, v]: [f64; 2]) {
        self.vector[self.layout.position_place(record)] = x;
        if let Some(place) = self.layout.speed_place(record) {
            self.vector[place] = v;
        }
    }

    /// The stiffness k in N/m, and the constant force in N. The constant force is k (x0 - reference) plus the offset
    /// force.
    pub(super) fn spring(&self) -> [f64; 2] {
        let stiffness = self.of(Stiffness);
        let known = self.layout.rest_m.map_or(0.0, |rest_m| stiffness * rest_m);
        [stiffness, self.fitted(Constant).map_or(known, |constant| known + constant)]
    }

    /// Friction in N, and time constant of the amplifier in s. Both are at least 0.
    pub(super) fn slow(&self) -> [f64; 2] {
        [Friction, Lag].map(|parameter| self.of(parameter).max(0.0))
    }

    /// Whether friction, lag and rise are at least 0, and the Stribeck speed is above 0.
    pub(super) fn is_allowed(&self) -> bool {
        let fall = self.fitted(Fall);
        [Friction, Lag, Rise].into_iter().all(|one| self.of(one) >= 0.0)
            && fall.is_none_or(|fall| fall > 0.0)
    }

    /// Values for another layout. Parameters of both layouts keep their values.
    pub(super) fn within(&self, layout: Layout) -> Self {
        let mut values = Self::zeros(layout);
        for parameter in layout.fitted() {
            values.set(parameter, self.of(parameter));
        }
        // If x0 is known in only one of the two layouts, the constant changes its meaning: c = k (x0 - reference)
        // becomes an offset force, or the reverse.
        let [stiffness, constant] = self.spring();
        values.set(Constant, constant - layout.rest_m.map_or(0.0, |rest_m| stiffness * rest_m));
        for record in 0..layout.records {
            values.set_start(record, self.start(record));
        }
        values
    }
}
