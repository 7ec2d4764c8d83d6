//! Selects the terms of the model: forward selection with the test of [`super::terms`].
//!
//! Forward: among the terms that pass the test, the search adds the term that leaves the smallest residual. The search
//! repeats this until no term passes. The encoder's error is tried after all other terms. Backward: the search removes
//! a term that no longer passes the test when the other terms are in the model.

use std::{cell::OnceCell, f64::consts::TAU};

use levenberg_marquardt::LeastSquaresProblem as _;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF as _, Normal};

use super::{
    Options, checks, cogs,
    confidence::{self, Estimate, Estimates, standard_error},
    fit::{self, Fitted, Problem, Solution},
    layout::{Included, Layout, Parameter, Values},
    misfit::{Misfit, misfit},
    record::Record,
    residual::Weighed,
    terms::{FAMILY_P, Term, Terms, Tested, said, tail},
    weighting::Weighting,
};

/// Number of rows over which a speed is taken.
pub(super) const FAST_ROWS: usize = 8;
/// Largest share of the sum of squares that a model with a curve should leave, because a curve also follows other
/// missing effects. A curve that leaves more is only accepted if the model with this curve explains the residual.
const CURVE_LEAVES: f64 = 0.25;
/// Amplitude of a force that is tried, as a share of the largest command.
const SMALL_FORCE: f64 = 1e-4;
/// Smallest force between two masses that moves a play, as a share of the largest.
const STILL_SHARE: f64 = 1e-3;
/// Longest time constant of the handle that an amplifier's lag may stand in for, in rows, if the lag is shorter.
const EXCHANGED_ROWS: f64 = 100.0;
/// Number of starts from which a fit is made.
pub(super) const STARTS_TAKEN: usize = 3;
/// Limit for the ratio of two missing forces. The second force is computed with twice the stride of the first. If
/// position noise makes the force, the ratio is 1/4. For a white force it is the root of 1/2. The limit is between
/// these two ratios.
const STILL_NOISE: f64 = 0.5;
/// Smallest number of rows of the shortest record, divided by the rows of the longest stride.
const STRIDES: usize = 20;
/// The estimates are also computed with a stride that is shorter by the factor `ASIDE`, and with a longer one. Then the
/// estimates are compared.
const ASIDE: usize = 4;

pub(super) struct Model {
    pub solution: Solution,
    pub weighed: Weighed,
    pub estimates: Estimates,
    /// Orthonormal basis of the space that the derivatives span.
    pub basis: DMatrix<f64>,
    /// Number of cycles that were examined for the encoder's error.
    cycles: f64,
    /// The misfit of the residual. It is computed when it is needed first.
    misfit: OnceCell<Option<Misfit>>,
}

impl Model {
    fn new(search: &Search<'_>, solution: Solution, cycles: f64) -> Result<Self, String> {
        let Search { records, options, weighting } = search;
        let left = (&solution.residual_m, solution.values.layout().reference_m);
        let weighed = Weighed::new(records, left, options);
        let given = (&weighed, weighting);
        let estimates = confidence::estimates(&solution, given, &mut [], records[0].stop)?;
        let mut jacobian = solution.jacobian.clone();
        for mut column in jacobian.column_iter_mut() {
            let norm = column.norm().max(f64::MIN_POSITIVE);
            column.unscale_mut(norm);
        }
        let basis = jacobian.qr().q();
        Ok(Self { solution, weighed, estimates, basis, cycles, misfit: OnceCell::new() })
    }

    pub(super) fn values(&self) -> &Values {
        &self.solution.values
    }

    pub(super) fn layout(&self) -> &Layout {
        self.values().layout()
    }

    pub(super) fn squares(&self) -> f64 {
        self.solution.weighed_m.norm_squared()
    }

    /// The part of a column that is orthogonal to the model's own derivatives.
    pub(super) fn without(&self, column: &DVector<f64>) -> DVector<f64> {
        column - &self.basis * self.basis.tr_mul(column)
    }

    /// Estimates by how much this column would reduce the sum of squares.
    fn promised(&self, column: &DVector<f64>) -> Option<f64> {
        let left = self.without(column);
        let promised = left.dot(&self.solution.weighed_m).powi(2) / left.norm_squared();
        promised.is_finite().then_some(promised)
    }

    /// The size of a term of the model.
    fn size(&self, term: Term) -> Option<Estimate> {
        let Estimates { friction, lag, offset, phase, stribeck, cogging, .. } = self.estimates;
        match term {
            Term::Friction => friction,
            Term::Amplifier => lag,
            Term::Offset => offset,
            Term::Stribeck => stribeck.map(|[rise, ..]| rise),
            Term::Cogging => cogging.map(|[amplitude, ..]| amplitude),
            Term::Phase => phase.map(|[first, ..]| first),
        }
    }

    /// The term whose interval reaches furthest beyond 0. Friction is left out, because every device has it.
    fn unsure(&self) -> Option<Term> {
        let sizes = Term::ALL.into_iter().filter(|term| *term != Term::Friction);
        let sizes = sizes.filter_map(|term| Some((term, self.size(term)?)));
        let parts = sizes.map(|(term, size)| (term, size.value.abs() / size.half_width));
        let unsure = parts.filter(|(_, part)| *part < 1.0);
        unsure.min_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(term, _)| term)
    }

    /// Tests a term of the model. `candidates` is the number of terms that were tried.
    fn tested(&self, term: Term, candidates: usize) -> Tested {
        let value = self.size(term);
        let z = value.map_or(0.0, |value| value.value / standard_error(&value));
        let p = match term {
            Term::Friction | Term::Stribeck | Term::Amplifier => tail(z),
            Term::Offset => 2.0 * tail(z.abs()),
            Term::Cogging | Term::Phase => self.cycles * (-0.5 * z * z).exp(),
        };
        Tested { term, z, p: (p * candidates as f64).min(1.0) }
    }
}

/// The terms that a record can show. The offset is only a candidate if the rest position is known or there is no
/// spring. In all other cases the rest position includes the offset.
pub(super) fn candidates(layout: &Layout) -> Vec<Term> {
    let offset = layout.rest_m.is_some() || !layout.spring;
    Term::ALL.into_iter().filter(|term| *term != Term::Offset || offset).collect()
}

/// Chooses the model of the records. The search begins with first values of the plain model. It adds the terms that
/// `options` request, or else the terms that the records show.
///
/// # Errors
/// The message has one line: no model describes the records, or the records cannot distinguish parameters.
pub(super) fn choose(
    records: &[Fitted<'_>],
    values: &Values,
    options: &Options,
) -> Result<(Model, Vec<Tested>, Weighting), String> {
    let mut search = Search { records, options, weighting: Weighting::White };
    let solved = fit::solve(search.problem(values.clone()));
    let plain = solved.and_then(|solution| Model::new(&search, solution, 1.0));
    let is_auto = options.terms == Terms::Auto;
    let mut model = match plain {
        plain if is_auto => search.automatic(values, plain)?,
        plain if Term::ALL.iter().all(|term| !options.terms.asks(*term)) => plain?,
        plain => search.asked(values, plain.as_ref().ok())?,
    };
    if model.weighed.found.is_bound_by_quantisation() {
        let readings = records.iter().map(|fitted| &fitted.positions_m[fitted.first..]);
        search.weighting = Weighting::of_readings(&readings.collect::<Vec<_>>());
        if let Ok(weighed) = search.fit(*model.layout(), model.values(), model.cycles) {
            model = if is_auto { search.automatic(values, Ok(weighed))? } else { weighed };
        } else {
            search.weighting = Weighting::White;
        }
    }
    if !search.is_explained(&model) {
        checks::explains(model.weighed.found.rms_m, fit::motion(records))?;
        model = search.by_force(model, values)?;
    }
    let candidates = if is_auto { candidates(values.layout()).len() } else { 1 };
    let mut tests = search.tests(&model, candidates);
    search.widen_all(&mut model)?;
    // Where the model lacks something, this may look like a term. Then the widened interval of the term contains 0, and
    // the record does not show the term.
    while is_auto
        && !search.is_explained(&model)
        && let Some(term) = model.unsure()
        && let Ok(mut fewer) = search.dropped(&model, term)
    {
        tests = search.tests(&fewer, candidates);
        search.widen_all(&mut fewer)?;
        model = fewer;
    }
    Ok((model, tests, search.weighting))
}

/// A linear step to a model with an encoder's error.
pub(super) struct EncoderStep {
    pub values: Values,
    /// The expected reduction of the sum of squares.
    pub gain: f64,
    /// Number of cycles that were examined.
    pub looked_at: f64,
}

/// The records, options and weights that all fits of a search share.
pub(super) struct Search<'a> {
    pub records: &'a [Fitted<'a>],
    pub options: &'a Options,
    pub weighting: Weighting,
}

/// Requested terms are added in one of these orders. A term that is added too early may hide another term and make the
/// fit wrong.
const ORDERS: [[Term; 6]; 2] = [
    [Term::Offset, Term::Amplifier, Term::Friction, Term::Stribeck, Term::Cogging, Term::Phase],
    [Term::Friction, Term::Stribeck, Term::Amplifier, Term::Offset, Term::Cogging, Term::Phase],
];

impl Search<'_> {
    /// Fits the model with the requested terms, even if the record does not show them.
    fn asked(&self, values: &Values, plain: Option<&Model>) -> Result<Model, String> {
        let asked = |term: &Term| self.options.terms.asks(*term);
        if let Some(model) = self.with_all(asked, values, plain) {
            return Ok(model);
        }
        // The least necessary term. Without it, the other terms leave the smallest residual.
        let without = |one: Term| {
            let others = self.with_all(|term| asked(term) && *term != one, values, plain)?;
            Some((one, others.squares()))
        };
        let each = Term::ALL.into_iter().filter(asked).filter_map(without);
        let hidden = each.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(term, _)| term);
        let names = Term::ALL.into_iter().filter(asked).map(said).collect::<Vec<_>>().join(", ");
        Err(format!(
            "the record does not show the {}",
            hidden.map_or(names, |term| said(term).into())
        ))
    }

    /// The model with all requested terms, or the plain model if none is requested.
    fn with_all(
        &self,
        asked: impl Fn(&Term) -> bool,
        values: &Values,
        plain: Option<&Model>,
    ) -> Option<Model> {
        if Term::ALL.iter().all(|term| !asked(term)) {
            return plain.and_then(|plain| self.fit(*plain.layout(), plain.values(), 1.0).ok());
        }
        ORDERS.into_iter().find_map(|order| {
            let mut model: Option<Model> = None;
            for term in order.into_iter().filter(&asked) {
                let before = model.as_ref().or(plain);
                let from = before.map_or(values, Model::values);
                model = Some(self.with(term, from, before, false)?);
            }
            model
        })
    }

    fn automatic(&self, values: &Values, plain: Result<Model, String>) -> Result<Model, String> {
        let candidates = candidates(values.layout());
        let passes = |model: &Model, term: Term| model.tested(term, candidates.len()).p < FAMILY_P;
        let mut model = plain;
        let mut added: Vec<(Term, Values)> = vec![];
        loop {
            let before = model.as_ref().ok();
            let from = before.map_or(values, Model::values);
            let passing = |is_periodic: bool| {
                let terms = from.layout().terms;
                let left = candidates.iter().filter(|term| !term.is_in(terms));
                let left = left.filter(|term| term.is_periodic() == is_periodic);
                let left = left.filter(|term| **term != Term::Stribeck || terms.friction);
                let tried = left.filter_map(|term| {
                    let found = self.with(*term, from, before, true)?;
                    let is_trusted = || {
                        let falls_to = before.map(|before| found.squares() / before.squares());
                        falls_to.is_some_and(|part| part < CURVE_LEAVES)
                            || self.is_explained(&found)
                    };
                    let is_taken = passes(&found, *term) && (!term.is_a_curve() || is_trusted());
                    is_taken.then_some((*term, found))
                });
                tried.min_by(|(_, a), (_, b)| a.squares().total_cmp(&b.squares()))
            };
            // Periodic terms are tried last, because other missing effects also give lines in the spectrum over the
            // position.
            let Some((term, best)) = passing(false).or_else(|| passing(true)) else { break };
            added.extend(before.map(|before| (term, before.values().clone())));
            model = Ok(best);
        }
        let model = self.without_stand_ins(self.or_exchanged(model?), &added);
        let mut model = self.or_falling(model);
        // The least certain term is removed first, because it may make the others uncertain.
        loop {
            let inside = candidates.iter().filter(|term| term.is_in(model.layout().terms));
            let tests = inside.map(|term| model.tested(*term, candidates.len()));
            let mut failed: Vec<Tested> = tests.filter(|test| test.p >= FAMILY_P).collect();
            failed.sort_by(|a, b| a.z.abs().total_cmp(&b.z.abs()));
            let mut without = failed.into_iter().map(|test| self.dropped(&model, test.term));
            let Some(first) = without.next() else { break };
            model = first.or_else(|error| without.find_map(Result::ok).ok_or(error))?;
        }
        // Every device has friction. So if friction explains the record as well as an amplifier or offset term, that
        // term is not reported.
        let others = [Term::Amplifier, Term::Offset].into_iter();
        for term in others.filter(|_| !model.layout().terms.friction) {
            if !term.is_in(model.layout().terms) {
                continue;
            }
            let terms = term.add(model.layout().terms, false);
            let without = model.values().within(Layout { terms, ..*model.layout() });
            let room = enough() * model.squares() / self.rows(&model);
            let instead = self.with(Term::Friction, &without, None, false);
            if let Some(instead) = instead.filter(|one| one.squares() < model.squares() + room) {
                model = match passes(&instead, Term::Friction) {
                    true => instead,
                    false => self.fit(*without.layout(), &without, 1.0)?,
                };
                break;
            }
        }
        Ok(model)
    }

    /// The better of two fits: this one, and the fit with friction that falls with the speed instead of cogging. At each
    /// reversal both push in the same way, and cogging is found from worse values of the other parameters.
    fn or_falling(&self, model: Model) -> Model {
        let Included { friction, stribeck, cogging, .. } = model.layout().terms;
        if !(friction && cogging) || stribeck {
            return model;
        }
        let terms = Term::Cogging.add(model.layout().terms, false);
        let start = model.values().within(Layout { terms, cogs_per_m: None, ..*model.layout() });
        let falling = self.with(Term::Stribeck, &start, None, false);
        falling.filter(|falling| falling.squares() < model.squares()).unwrap_or(model)
    }

    /// The model without terms that later terms make unnecessary. A term that is added early may stand in for a later
    /// one, with values of the other parameters from which no fit leads back. So the fit without it begins with the
    /// values from before it was added. `added` has the terms in the order in which they were added, and these values.
    fn without_stand_ins(&self, mut model: Model, added: &[(Term, Values)]) -> Model {
        for (term, before) in added.iter().rev().skip(1) {
            let terms = term.add(model.layout().terms, false);
            let layout = Layout { terms, ..*model.layout() };
            let mut start = model.values().within(layout);
            for parameter in before.layout().fitted() {
                start.set(parameter, before.of(parameter));
            }
            for record in 0..self.records.len() {
                start.set_start(record, before.start(record));
            }
            let room = enough() * model.squares() / self.rows(&model);
            let most = model.squares() + room;
            let without = self.fit(layout, &start, model.cycles).ok();
            model = without.filter(|without| without.squares() < most).unwrap_or(model);
        }
        model
    }

    fn tests(&self, model: &Model, candidates: usize) -> Vec<Tested> {
        let inside = Term::ALL.into_iter().filter(|term| term.is_in(model.layout().terms));
        inside.map(|term| model.tested(term, candidates)).collect()
    }

    /// The best fit with one more term; `None` if no fit leaves a smaller residual. If `likely` is true, a term is only
    /// tried if a linear step promises a significant reduction.
    fn with(
        &self,
        term: Term,
        from: &Values,
        before: Option<&Model>,
        likely: bool,
    ) -> Option<Model> {
        if self.records.iter().any(Fitted::is_stopped) {
            return None;
        }
        // If a curve is missing in the model, the residual contains more than noise.
        if likely && term.is_a_curve() && self.is_explained(before?) {
            return None;
        }
        match term {
            Term::Phase => return self.with_phase(before?, likely),
            Term::Cogging => return self.with_cogging(before?),
            _ => {}
        }
        let more = Layout { terms: term.add(from.layout().terms, true), ..*from.layout() };
        let start = from.within(more);
        if let Some(model) = before.filter(|_| likely && term != Term::Stribeck) {
            let rows = self.rows(model);
            let is_promised = self.explains(term, model)? / (model.squares() / rows) >= enough();
            // A handle at rest hides the effect of a small friction.
            if !is_promised && (term != Term::Friction || self.is_explained(model)) {
                return None;
            }
        }
        let starts = self.starts(term, &start);
        // A requested term with the value 0 may increase the residual by a rounding error.
        let room = if likely { 1.0 } else { 1.0 + 1e-6 };
        let most = room * before.map_or(f64::INFINITY, Model::squares);
        let fits = starts.iter().filter_map(|start| self.fit(more, start, 1.0).ok());
        let fits = fits.filter(|model| model.squares() < most);
        let best = fits.min_by(|a, b| a.squares().total_cmp(&b.squares()))?;
        Some(self.or_exchanged(best))
    }

    /// The better of two fits: this one, and the fit that begins with the handle's time constant m / b and the
    /// amplifier's lag exchanged. The speed follows the command through both lags. The order of two lags does not
    /// matter, so both fits may be minima.
    fn or_exchanged(&self, model: Model) -> Model {
        let (values, layout) = (model.values(), *model.layout());
        let [_, lag_s] = values.slow();
        let damping = values.of(Parameter::Damping);
        let own_s = values.of(Parameter::Mass) / damping;
        let most_s = lag_s.max(EXCHANGED_ROWS * self.records[0].record.step_s);
        if !layout.terms.lag || own_s <= 0.0 || own_s > most_s {
            return model;
        }
        let mut start = values.clone();
        start.set(Parameter::Mass, damping * lag_s);
        start.set(Parameter::Lag, own_s);
        let other = self.fit(layout, &start, model.cycles);
        other.ok().filter(|other| other.squares() < model.squares()).unwrap_or(model)
    }

    fn with_phase(&self, before: &Model, likely: bool) -> Option<Model> {
        // At constant speed, the quantiser's sawtooth also gives lines in the spectrum over the position.
        let residual = &before.weighed.found;
        let is_quantised = residual.is_bound_by_quantisation()
            && self.is_explained(before)
            && !residual.hides_quantisation();
        if likely && (is_quantised || self.weighting.is_force()) {
            return None;
        }
        let EncoderStep { values: step, gain, looked_at } = self.of_encoder(before)?;
        let rows = self.rows(before);
        if likely && gain / (before.squares() / rows) < enough() + 2.0 * looked_at.ln() {
            return None;
        }
        let mut model = self.fit(*step.layout(), &step, looked_at).ok()?;
        if self.options.cycle_m.is_none() {
            let free = Layout { cycles_per_m: None, ..*model.layout() };
            model = self.fit(free, &model.values().within(free), looked_at).ok()?;
        }
        let second =
            Layout { terms: Included { second: true, ..model.layout().terms }, ..*model.layout() };
        if let Some((step, _)) = self.linear_step(&model.values().within(second))
            && let Ok(twice) = self.fit(second, &step, looked_at)
            && let Some([_, amplitude, ..]) = twice.estimates.phase
            && tail(amplitude.value / standard_error(&amplitude)) < FAMILY_P
        {
            model = twice;
        }
        // With a steeper encoder error, the reading would fall while the position rises.
        let [first, second, _, cycle] = model.estimates.phase?;
        let is_encoder = TAU * (first.value + 2.0 * second.value.abs()) < cycle.value;
        (is_encoder && model.squares() < before.squares()).then_some(model)
    }

    /// Tries whether a delay instead of the amplifier's lag leaves an equal residual. If so, returns the latency of
    /// this fit in rows. Returns `None` if the record distinguishes delay and lag, or if the latency is fitted.
    pub(super) fn delay_instead(&self, model: &Model) -> Option<f64> {
        let layout = *model.layout();
        let latency_s = layout.latency_s.filter(|_| layout.terms.lag)?;
        let [_, lag_s] = model.values().slow();
        let terms = Term::Amplifier.add(layout.terms, false);
        let late = Layout { terms, latency_s: None, ..layout };
        let mut start = model.values().within(late);
        start.set(Parameter::Latency, latency_s + lag_s);
        let delayed = self.fit(late, &start, 1.0).ok()?;
        let rows = self.rows(model);
        let more = (delayed.squares() - model.squares()) / (model.squares() / rows);
        let step_s = self.records[0].record.step_s;
        (more < enough()).then(|| delayed.values().of(Parameter::Latency) / step_s)
    }

    /// Estimates by how much a term would reduce the sum of squares. The estimate is linear.
    pub(super) fn explains(&self, term: Term, model: &Model) -> Option<f64> {
        if term == Term::Phase {
            return self.of_encoder(model).map(|step| step.gain);
        }
        let more = Layout { terms: term.add(model.layout().terms, true), ..*model.layout() };
        self.explains_by(more, term.parameter(), model)
    }

    /// Estimates by how much one more parameter would reduce the sum of squares. The estimate is linear.
    pub(super) fn explains_by(
        &self,
        layout: Layout,
        parameter: Parameter,
        model: &Model,
    ) -> Option<f64> {
        model.promised(&self.problem(model.values().within(layout)).by(parameter)?)
    }

    /// Estimates by how much one more force would reduce the sum of squares. The estimate is linear. The force depends
    /// on command, position and speed.
    pub(super) fn explains_force(
        &self,
        force: impl Fn(f64, f64, f64) -> f64,
        model: &Model,
    ) -> Option<f64> {
        let pushed = |fitted: &Fitted<'_>| {
            let (x, step_s) = (&fitted.positions_m, fitted.record.step_s);
            let forces = fitted.record.command.iter().enumerate().map(|(row, command)| {
                let (from, to) =
                    (row.saturating_sub(FAST_ROWS), (row + FAST_ROWS).min(x.len() - 1));
                force(*command, x[row], (x[to] - x[from]) / ((to - from) as f64 * step_s))
            });
            let forces: Vec<f64> = forces.collect();
            let most = |all: &[f64]| {
                all.iter().fold(f64::MIN_POSITIVE, |most: f64, one| most.max(one.abs()))
            };
            let size = SMALL_FORCE * most(&fitted.record.command) / most(&forces);
            let mut record = fitted.record.clone();
            record
                .command
                .iter_mut()
                .zip(&forces)
                .for_each(|(command, force)| *command += size * force);
            record
        };
        let records: Vec<Record> = self.records.iter().map(pushed).collect();
        let own = self.records.iter().zip(&records);
        let fitted: Vec<_> = own.map(|(own, record)| Fitted { record, ..own.clone() }).collect();
        let problem = Problem { records: &fitted, ..self.problem(model.values().clone()) };
        let by = problem.residuals()? - self.problem(model.values().clone()).residuals()?;
        model.promised(&by)
    }

    /// Estimates by how much a play between two masses would reduce the sum of squares. The estimate is linear. A play
    /// moves the measured mass by a constant in the direction of `side`, which depends on speed and acceleration.
    pub(super) fn explains_play(
        &self,
        side: impl Fn(f64, f64) -> f64,
        model: &Model,
    ) -> Option<f64> {
        let shifts = model.weighed.pieces().into_iter().enumerate().flat_map(|(record, piece)| {
            let x = piece.position;
            let last = x.len().saturating_sub(1 + FAST_ROWS).max(FAST_ROWS);
            let sides = (0..x.len()).map(|row| {
                let row = row.clamp(FAST_ROWS, last);
                let [before, here, after] = [x[row - FAST_ROWS], x[row], x[row + FAST_ROWS]];
                side(0.5 * (after - before), after - 2.0 * here + before)
            });
            let sides: Vec<f64> = sides.collect();
            let least = STILL_SHARE * sides.iter().fold(0.0, |most: f64, one| most.max(one.abs()));
            // Without a force between the two masses, the play stays as it is.
            let shifts = sides.iter().scan(0.0, |shift, side| {
                *shift = if side.abs() > least { side.signum() } else { *shift };
                Some(*shift)
            });
            self.weighting.weighed(record, shifts.collect())
        });
        model.promised(&DVector::from_vec(shifts.collect()))
    }

    /// The fit without this term.
    fn dropped(&self, model: &Model, term: Term) -> Result<Model, String> {
        let terms = term.add(model.layout().terms, false);
        self.fit(Layout { terms, ..*model.layout() }, model.values(), 1.0)
    }

    /// Widens the intervals by all that the fit does not show.
    fn widen_all(&self, model: &mut Model) -> Result<(), String> {
        self.widen(model)?;
        self.hold_profile(model);
        if let Weighting::Force { stride, .. } = self.weighting {
            // If a force is missing in the model, the estimates depend on the stride.
            let strides = [(stride / ASIDE).max(1), stride * ASIDE];
            let others = strides.map(|stride| self.by_stride(model, stride));
            others.iter().flatten().for_each(|other| model.estimates.hold(&other.estimates));
        }
        Ok(())
    }

    /// Fits the model again, with weights that convert the residual to the force that is missing in the model.
    fn by_force(&mut self, mut model: Model, values: &Values) -> Result<Model, String> {
        let most = self.records.iter().map(Fitted::rows).min().unwrap_or(0) / STRIDES;
        let is_auto = self.options.terms == Terms::Auto;
        let mut noise = 1;
        for _ in 0..2 {
            let forces = |stride: usize| {
                let (pieces, weighting) = (model.weighed.pieces(), self.force(&model, stride));
                let squares = pieces.iter().map(|piece| weighting.squares(piece.residual));
                squares.sum::<f64>().sqrt() / (stride * stride) as f64
            };
            noise = 1;
            while 4 * noise <= most && forces(2 * noise) < STILL_NOISE * forces(noise) {
                noise *= 2;
            }
            let Ok(found) = self.by_stride(&model, noise) else { break };
            model = found;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "up to the rows"
        )]
        let stride = (noise as f64 * most.max(noise) as f64).sqrt() as usize;
        model = self.by_stride(&model, stride)?;
        self.weighting = self.force(&model, stride);
        if is_auto {
            model = self.automatic(values, Ok(model))?;
        }
        Ok(model)
    }

    /// Fits the model again, with weights that convert the residual to the missing force over `stride` rows.
    fn by_stride(&self, model: &Model, stride: usize) -> Result<Model, String> {
        let search = Search { weighting: self.force(model, stride), ..*self };
        let mut layout = *model.layout();
        if self.options.terms == Terms::Auto {
            // A slowly varying residual also gives lines in the spectrum over the position. They do not come from the
            // encoder.
            let terms = Term::Phase.add(layout.terms, false);
            layout = Layout { terms, cycles_per_m: None, ..layout };
        }
        search.fit(layout, model.values(), model.cycles)
    }

    /// The weighting that converts a residual to the force that is missing in the model, over `stride` rows.
    pub(super) fn force(&self, model: &Model, stride: usize) -> Weighting {
        let motion = self.problem(model.values().clone()).motion(0);
        Weighting::of_force(&motion, self.records[0].record.step_s, stride)
    }

    /// The part of the rows' errors that the fit does not remove.
    fn left(&self, model: &Model, errors: DVector<f64>) -> DVector<f64> {
        let Some(weights) = self.weights() else { return model.without(&errors) };
        model.without(&errors.component_mul(&weights)).component_div(&weights)
    }

    /// Weights of the rows; `None` if all rows have the same weight.
    fn weights(&self) -> Option<DVector<f64>> {
        let Weighting::Readings(weights) = &self.weighting else { return None };
        Some(DVector::from_vec(weights.concat()))
    }

    pub(super) fn rows(&self, model: &Model) -> f64 {
        self.weighting.rows(model.solution.weighed_m.len())
    }

    pub(super) fn problem(&self, values: Values) -> Problem<'_> {
        Problem { records: self.records, values, weighting: &self.weighting }
    }

    /// Whether the model explains the residual: the residual is white, or it agrees with quantisation.
    pub(super) fn is_explained(&self, model: &Model) -> bool {
        let residual = &model.weighed.found;
        residual.is_white() || (residual.is_bound_by_quantisation() && self.misfit(model).is_none())
    }

    /// The misfit of a model's residual; `None` if the residual agrees with quantisation.
    pub(super) fn misfit(&self, model: &Model) -> Option<Misfit> {
        let left = |errors| self.left(model, errors);
        *model.misfit.get_or_init(|| misfit(&model.weighed, self.weights().as_ref(), left))
    }

    /// The best fit with cogging. The pitches that would reduce the sum of squares most are tried.
    fn with_cogging(&self, before: &Model) -> Option<Model> {
        let layout = |line: &cogs::Line| Layout {
            terms: Term::Cogging.add(before.layout().terms, true),
            cogs_per_m: Some(line.cogs_per_m),
            ..*before.layout()
        };
        let steps = self.of_motor(before).into_iter().filter_map(|line| {
            let (step, gain) = self.linear_step(&before.values().within(layout(&line)))?;
            Some((gain, step, line))
        });
        let mut steps: Vec<(f64, Values, cogs::Line)> = steps.collect();
        steps.sort_by(|a, b| b.0.total_cmp(&a.0));
        let fits = steps.iter().take(STARTS_TAKEN).filter_map(|(_, step, line)| {
            let model = self.fit(layout(line), step, line.looked_at).ok()?;
            // Friction or an offset that stood in for the cogging may now be 0. At 0 friction, no fit may succeed.
            let gone: [&[Term]; 3] = [&[], &[Term::Friction], &[Term::Friction, Term::Offset]];
            gone.into_iter().find_map(|gone| {
                let all = model.layout().terms;
                let terms = gone.iter().fold(all, |terms, term| term.add(terms, false));
                let free = Layout { terms, cogs_per_m: None, ..*model.layout() };
                self.fit(free, &model.values().within(free), line.looked_at).ok()
            })
        });
        let best = fits.min_by(|a, b| a.squares().total_cmp(&b.squares()))?;
        (best.squares() < before.squares()).then_some(best)
    }

    /// Fits `layout`, beginning with the values of any layout. If friction holds the handle at the first row, the first
    /// speed is 0 and is not fitted.
    fn fit(&self, layout: Layout, from: &Values, cycles: f64) -> Result<Model, String> {
        let mut values = self.held(from.within(layout));
        loop {
            let solution = fit::solve(self.problem(values))?;
            values = self.held(solution.values.clone());
            if values.layout() == solution.values.layout() {
                return Model::new(self, solution, cycles);
            }
        }
    }

    /// The values without the first speeds of those records in which friction holds the handle at the first row.
    fn held(&self, values: Values) -> Values {
        let problem = self.problem(values);
        let (layout, values) = (*problem.values.layout(), &problem.values);
        let held = Layout { resting: layout.resting | self.resting(&problem), ..layout };
        if held == layout { problem.values } else { values.within(held) }
    }

    /// Finds the records in which friction holds the handle at the first row. Bit n of the result stands for record n.
    /// In these records, the fitted speed at the first row would let the handle slide by less than a count.
    fn resting(&self, problem: &Problem<'_>) -> u64 {
        let least_m = self.options.resolution_m.max(1e-9);
        let rests = |index: usize| {
            let (motion, fitted) = (problem.motion(index), &self.records[index]);
            let slides_m = motion.v * motion.v / (2.0 * motion.friction);
            motion.friction > 0.0
                && slides_m < least_m
                && motion.begins_at_rest(fitted.record, fitted.first)
        };
        (0..self.records.len().min(64))
            .filter(|index| rests(*index))
            .fold(0, |bits, index| bits | 1 << index)
    }
}

/// The smallest reduction of the sum of squares that is significant, divided by the mean square. The noise is taken as
/// white.
fn enough() -> f64 {
    Normal::standard().inverse_cdf(FAMILY_P / Term::ALL.len() as f64).powi(2)
}
