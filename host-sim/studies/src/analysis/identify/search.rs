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
    Options, checks,
    confidence::{self, Estimate, Estimates, Hidden, standard_error},
    cycle::{self, Cycles},
    fit::{self, Fitted, Problem, Solution},
    guess,
    layout::{Included, Layout, Parameter, Values},
    misfit::{Misfit, misfit},
    record::Record,
    residual::Weighed,
    terms::{FAMILY_P, Term, Terms, Tested, said, tail},
    weighting::Weighting,
};

/// First values that are tried for the friction, as shares of the largest force.
const FRICTION_STARTS: [f64; 3] = [0.02, 0.08, 0.2];
/// First values that are tried for the lag, in rows.
const LAG_STARTS: [f64; 2] = [0.5, 3.0];
/// First values that are tried for the Stribeck curve. `FALLS` has Stribeck speeds, as shares of the largest speed over
/// [`FAST_ROWS`]. `RISE` is the rise, as a share of Coulomb friction.
const FALLS: [f64; 4] = [0.01, 0.03, 0.1, 0.3];
const RISE: f64 = 0.2;
const FAST_ROWS: usize = 8;
/// Largest share of the sum of squares that a model with a curve should leave, because a curve also follows other
/// missing effects. A curve that leaves more is only accepted if the model with this curve explains the residual.
const CURVE_LEAVES: f64 = 0.25;
/// Amplitude of a force that is tried, as a share of the largest command.
const SMALL_FORCE: f64 = 1e-4;
/// Strides with which the search looks for cogging, in rows.
const STRIDES_OF_COGS: [usize; 3] = [2, 8, 32];
/// Largest number of times that the change of a parameter along the profile of the likelihood is doubled.
const PROFILE_STEPS: usize = 14;
/// First change of a term that is not in the model, as a share of the largest force. The first change of a parameter of
/// the model is a half-width.
const SMALL_TERM: f64 = 1e-4;
/// Number of starts from which a fit is made.
const STARTS_TAKEN: usize = 3;
/// Limit for the ratio of two missing forces. The second force is computed with twice the stride of the first. If
/// position noise makes the force, the ratio is 1/4. For a white force it is the root of 1/2. The limit is between
/// these two ratios.
const STILL_NOISE: f64 = 0.5;
/// Smallest number of rows of the shortest record, divided by the rows of the longest stride.
const STRIDES: usize = 20;
/// The estimates are also computed with a stride that is shorter by the factor `ASIDE`, and with a longer one. Then the
/// estimates are compared.
const ASIDE: usize = 4;
/// Largest friction after a step of the search, as a share of the largest force.
const FRICTION_MOST: f64 = 0.5;

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
        let weighed = Weighed::new(records, &solution, options);
        let given = (&weighed, weighting);
        let estimates = confidence::estimates(&solution, given, &[], records[0].stop)?;
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

    fn squares(&self) -> f64 {
        self.solution.weighed_m.norm_squared()
    }

    /// The part of a column that is orthogonal to the model's own derivatives.
    fn without(&self, column: &DVector<f64>) -> DVector<f64> {
        column - &self.basis * self.basis.tr_mul(column)
    }

    /// Tests a term of the model. `candidates` is the number of terms that were tried.
    fn tested(&self, term: Term, candidates: usize) -> Tested {
        let Estimates { friction, lag, offset, phase, stribeck, cogging, .. } = self.estimates;
        let value = match term {
            Term::Friction => friction,
            Term::Amplifier => lag,
            Term::Offset => offset,
            Term::Stribeck => stribeck.map(|[rise, ..]| rise),
            Term::Cogging => cogging.map(|[amplitude, ..]| amplitude),
            Term::Phase => phase.map(|[first, ..]| first),
        };
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
fn candidates(layout: &Layout) -> Vec<Term> {
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
        Ok(plain) if Term::ALL.iter().all(|term| !options.terms.asks(*term)) => plain,
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
    let tests = search.tests(&model, candidates);
    search.widen(&mut model)?;
    search.hold_profile(&mut model);
    if let Weighting::Force { stride, .. } = search.weighting {
        // If a force is missing in the model, the estimates depend on the stride.
        let strides = [(stride / ASIDE).max(1), stride * ASIDE];
        let others = strides.map(|stride| search.by_stride(&model, stride));
        others.iter().flatten().for_each(|other| model.estimates.hold(&other.estimates));
    }
    Ok((model, tests, search.weighting))
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
                    (passes(&found, *term) && (!term.is_a_curve() || is_trusted())).then_some(found)
                });
                tried.min_by(|a, b| a.squares().total_cmp(&b.squares()))
            };
            // Periodic terms are tried last, because other missing effects also give lines in the spectrum over the
            // position.
            let Some(best) = passing(false).or_else(|| passing(true)) else { break };
            model = Ok(best);
        }
        let mut model = model?;
        while let Some(gone) = candidates
            .iter()
            .find(|term| term.is_in(model.layout().terms) && !passes(&model, **term))
        {
            let terms = gone.add(model.layout().terms, false);
            model = self.fit(Layout { terms, ..*model.layout() }, model.values(), 1.0)?;
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
        let mut starts = vec![];
        starts.extend(self.linear_step(&start).map(|(step, _)| self.bounded(step)));
        if term == Term::Friction {
            let windows = guess::WINDOWS.into_iter();
            starts.extend(windows.filter_map(|windows| self.in_motion(&start, windows)));
        }
        let parameter = match term {
            Term::Friction => Some((Parameter::Friction, self.force_n(&start))),
            Term::Amplifier => Some((Parameter::Lag, self.records[0].record.step_s)),
            _ => None,
        };
        if let Some((parameter, unit)) = parameter {
            let shares: &[f64] =
                if term == Term::Friction { &FRICTION_STARTS } else { &LAG_STARTS };
            starts.extend(shares.iter().map(|share| {
                let mut start = start.clone();
                start.set(parameter, share * unit);
                start
            }));
        }
        if term == Term::Stribeck {
            starts = self.stribeck_starts(&start);
        }
        // Near starts come first, because a far start may end in another minimum.
        let mut starts: Vec<(f64, Values)> = starts
            .into_iter()
            .filter_map(|start| {
                let problem = self.problem(start);
                let squares = problem.residuals()?.norm_squared();
                Some((squares, problem.values))
            })
            .collect();
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        starts.truncate(STARTS_TAKEN);
        // A requested term with the value 0 may increase the residual by a rounding error.
        let room = if likely { 1.0 } else { 1.0 + 1e-6 };
        let most = room * before.map_or(f64::INFINITY, Model::squares);
        let fits = starts.iter().filter_map(|(_, start)| self.fit(more, start, 1.0).ok());
        let fits = fits.filter(|model| model.squares() < most);
        fits.min_by(|a, b| a.squares().total_cmp(&b.squares()))
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
        let seen = self.of_encoder(before)?;
        let more = Layout {
            terms: Term::Phase.add(before.layout().terms, true),
            cycles_per_m: Some(seen.cycles_per_m),
            ..*before.layout()
        };
        let (step, gain) = self.linear_step(&before.values().within(more))?;
        let rows = self.rows(before);
        if likely && gain / (before.squares() / rows) < enough() + 2.0 * seen.looked_at.ln() {
            return None;
        }
        let mut model = self.fit(more, &step, seen.looked_at).ok()?;
        if self.options.cycle_m.is_none() {
            let free = Layout { cycles_per_m: None, ..*model.layout() };
            model = self.fit(free, &model.values().within(free), seen.looked_at).ok()?;
        }
        let second =
            Layout { terms: Included { second: true, ..model.layout().terms }, ..*model.layout() };
        if let Some((step, _)) = self.linear_step(&model.values().within(second))
            && let Ok(twice) = self.fit(second, &step, seen.looked_at)
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
        let mut more = Layout { terms: term.add(model.layout().terms, true), ..*model.layout() };
        if term == Term::Phase {
            more.cycles_per_m = Some(self.of_encoder(model)?.cycles_per_m);
            return self.linear_step(&model.values().within(more)).map(|(_, gain)| gain);
        }
        self.explains_by(more, term.parameter(), model)
    }

    /// Estimates by how much one more parameter would reduce the sum of squares. The estimate is linear.
    pub(super) fn explains_by(
        &self,
        layout: Layout,
        parameter: Parameter,
        model: &Model,
    ) -> Option<f64> {
        let left = model.without(&self.problem(model.values().within(layout)).by(parameter)?);
        let promised = left.dot(&model.solution.weighed_m).powi(2) / left.norm_squared();
        promised.is_finite().then_some(promised)
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
        let left = model.without(&by);
        let promised = left.dot(&model.solution.weighed_m).powi(2) / left.norm_squared();
        promised.is_finite().then_some(promised)
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
    fn force(&self, model: &Model, stride: usize) -> Weighting {
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

    fn rows(&self, model: &Model) -> f64 {
        self.weighting.rows(model.solution.weighed_m.len())
    }

    fn problem(&self, values: Values) -> Problem<'_> {
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

    /// Widens the intervals because of terms that the record can neither show nor exclude.
    fn widen(&self, model: &mut Model) -> Result<(), String> {
        if self.options.terms != Terms::Auto {
            return Ok(());
        }
        let layout = *model.layout();
        // An offset is at most the friction, because a larger offset would move a handle at rest.
        let [friction_n, _] = model.values().slow();
        let most_n = if layout.terms.friction { friction_n } else { f64::INFINITY };
        let hidden = candidates(&layout).into_iter().filter_map(|term| {
            if term.is_in(layout.terms) || !matches!(term, Term::Friction | Term::Offset) {
                return None;
            }
            let values =
                model.values().within(Layout { terms: term.add(layout.terms, true), ..layout });
            let place = values.layout().place(term.parameter())?;
            let by = self.problem(values.clone()).by(term.parameter())?;
            let most = if term == Term::Offset { most_n } else { f64::INFINITY };
            Some(((values, place), Hidden { left: model.without(&by), by, most }))
        });
        let (with, hidden): (Vec<(Values, usize)>, Vec<Hidden>) = hidden.unzip();
        let given = (&model.weighed, &self.weighting);
        model.estimates =
            confidence::estimates(&model.solution, given, &hidden, self.records[0].stop)?;
        if model.estimates.is_widened {
            for ((values, place), Hidden { most, .. }) in with.into_iter().zip(hidden) {
                let by = SMALL_TERM * self.force_n(&values);
                self.profile(model, &values, (place, by, most));
            }
        }
        Ok(())
    }

    /// Widens the intervals by the profile of the likelihood. With friction the model has kinks. So the sets of
    /// parameters that explain a record lie along a curve. Derivatives at one point do not show this curve. So the
    /// parameter with the largest uncertainty is changed in steps, and all other parameters are fitted again. Each
    /// interval is widened to contain all values that explain the record as well as the fitted values.
    fn hold_profile(&self, model: &mut Model) {
        if !model.layout().terms.friction {
            return;
        }
        let Some(place) = weakest(&model.solution.jacobian) else { return };
        let squares = self.variance(model);
        let deviation = fit::deviation(&model.solution.jacobian, place) * squares.sqrt();
        let values = model.values().clone();
        self.profile(model, &values, (place, confidence::quantile() * deviation, f64::INFINITY));
    }

    /// Mean of the squares that the model leaves, over the degrees of freedom.
    fn variance(&self, model: &Model) -> f64 {
        model.squares() / (self.rows(model) - model.values().vector().len() as f64).max(1.0)
    }

    /// Changes the value at `place` in both directions, first by `by`, then by twice as much each time, and fits all
    /// other values. Widens the intervals to contain all values that explain the record as well as the model. The
    /// layout of `values` may have a term that the model lacks. The value changes by at most `most`.
    fn profile(&self, model: &mut Model, values: &Values, (place, by, most): (usize, f64, f64)) {
        let squares = self.variance(model);
        let Estimate { half_width, white_half_width, .. } = model.estimates.mass;
        let room = squares * (confidence::quantile() * half_width / white_half_width).powi(2);
        for side in [-1.0, 1.0] {
            let (mut at, mut last, mut next) = (values.clone(), 0.0, by);
            for _ in 0..PROFILE_STEPS {
                // The fit begins on the line through the first and the last values. A start beside this line may be in
                // another regime of friction.
                let by = f64::min(next, most);
                let mut start = at.clone();
                if last > 0.0 {
                    let begun = values.vector().iter().zip(start.slice_mut());
                    begun.for_each(|(from, to)| *to = from + (*to - from) * by / last);
                }
                let value = values.vector()[place] + side * by;
                let Some((found, left)) = self.problem(start).beside(place, value, squares) else {
                    break;
                };
                let more = left - model.squares();
                if more.is_nan() || more >= room {
                    break;
                }
                (at, last, next) = (found, by, 2.0 * by);
                // The limit is between this step and the next.
                if more > 0.5 * room || by >= most {
                    break;
                }
            }
            if last > 0.0 {
                model.estimates.reach(&model.solution.values, &at);
            }
        }
    }

    /// Finds the strongest line in the spectrum of the residual over the position.
    fn of_encoder(&self, model: &Model) -> Option<cycle::Line> {
        let residual = (model.solution.residual_m.as_slice(), model.weighed.unit_m);
        let cycles = self.options.cycle_m.map_or(Cycles::All, Cycles::Known);
        cycle::strongest(self.records, residual, cycles)
    }

    /// Finds the strongest line in the spectrum of the missing force over the position. Several strides are tried. A
    /// long stride averages over short pitches. With a short stride, noise hides the force.
    fn of_motor(&self, model: &Model) -> Option<cycle::Line> {
        let pieces = model.weighed.pieces();
        let lines = STRIDES_OF_COGS.into_iter().filter_map(|stride| {
            let weighting = self.force(model, stride);
            let mut forces = vec![];
            for (record, piece) in pieces.iter().enumerate() {
                let mut own = weighting.weighed(record, piece.residual.to_vec());
                // Each force is a mean with triangular weights. The middle of these weights is one stride before the
                // row.
                own.drain(..own.len().min(stride));
                own.iter_mut().take(stride).for_each(|force| *force = 0.0);
                own.resize(piece.residual.len(), 0.0);
                forces.extend(own);
            }
            cycle::strongest(self.records, (&forces, model.weighed.unit_m), Cycles::Long)
        });
        lines.max_by(|a, b| a.strength.total_cmp(&b.strength))
    }

    fn with_cogging(&self, before: &Model) -> Option<Model> {
        let seen = self.of_motor(before)?;
        let more = Layout {
            terms: Term::Cogging.add(before.layout().terms, true),
            cogs_per_m: Some(seen.cycles_per_m),
            ..*before.layout()
        };
        let (step, _) = self.linear_step(&before.values().within(more))?;
        let model = self.fit(more, &step, seen.looked_at).ok()?;
        let free = Layout { cogs_per_m: None, ..*model.layout() };
        let model = self.fit(free, &model.values().within(free), seen.looked_at).ok()?;
        (model.squares() < before.squares()).then_some(model)
    }

    /// First values of a fit with a Stribeck curve, for each speed in [`FALLS`].
    fn stribeck_starts(&self, start: &Values) -> Vec<Values> {
        let fastest =
            self.records.iter().flat_map(|Fitted { record, positions_m, first, .. }| {
                let rows = positions_m[*first..].windows(FAST_ROWS + 1);
                rows.map(|rows| {
                    (rows[FAST_ROWS] - rows[0]).abs() / (FAST_ROWS as f64 * record.step_s)
                })
            });
        let fastest = fastest.fold(0.0, f64::max);
        let of = |part: f64| {
            let mut values = start.clone();
            values.set(Parameter::Fall, part * fastest);
            values.set(Parameter::Rise, RISE * values.of(Parameter::Friction));
            let step = self.linear_step(&values).map(|(step, _)| step);
            step.filter(Values::is_allowed).unwrap_or(values)
        };
        FALLS.into_iter().map(of).collect()
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

    /// The values after one Gauss-Newton step, and the expected reduction of the sum of squares.
    fn linear_step(&self, values: &Values) -> Option<(Values, f64)> {
        let problem = self.problem(values.clone());
        let residual = -problem.residuals()?;
        let mut jacobian = problem.by_differences()?;
        let scales: Vec<f64> = jacobian
            .column_iter()
            .map(|column| column.norm())
            .map(|norm| if norm > 0.0 { norm } else { 1.0 })
            .collect();
        for (mut column, scale) in jacobian.column_iter_mut().zip(&scales) {
            column.unscale_mut(*scale);
        }
        let wanted = jacobian.tr_mul(&residual);
        let normal: DMatrix<f64> = jacobian.tr_mul(&jacobian);
        let step = guess::least_squares(normal, &wanted, 1e-13)?;
        let gain = wanted.dot(&step);
        let mut values = problem.values;
        for ((value, step), scale) in values.slice_mut().iter_mut().zip(&step).zip(scales) {
            *value += step / scale;
        }
        values.vector().iter().all(|value| value.is_finite()).then_some((values, gain))
    }

    /// First values of a fit, from the first record. Only windows in which the handle moves are used.
    fn in_motion(&self, start: &Values, windows: usize) -> Option<Values> {
        let Fitted { record, positions_m, first, added_kg, .. } = &self.records[0];
        let latency = start.of(Parameter::Latency) / record.step_s;
        let layout = start.layout();
        let has = (layout.spring, layout.place(Parameter::Constant).is_some());
        let (reduced, friction) =
            guess::moving((record, positions_m, *first), latency, has, windows)?;
        let mass = start.of(Parameter::Gain) / reduced.gain - added_kg;
        let mut found = start.clone();
        let rest_m = start.layout().rest_m.unwrap_or_default();
        for (parameter, value) in [
            (Parameter::Mass, mass),
            (Parameter::Damping, reduced.d * mass),
            (Parameter::Stiffness, reduced.w * mass),
            (Parameter::Constant, (reduced.offset - reduced.w * rest_m) * mass),
            (Parameter::Friction, friction * mass),
        ] {
            found.set(parameter, value);
        }
        found.set_start(0, [reduced.x, reduced.v]);
        (mass > 0.0).then_some(found)
    }

    /// Limits friction and lag to realistic values.
    fn bounded(&self, mut values: Values) -> Values {
        let most_n = FRICTION_MOST * self.force_n(&values);
        let step_s = self.records[0].record.step_s;
        for (parameter, low, high) in [
            (Parameter::Friction, 1e-6 * most_n, most_n),
            (Parameter::Lag, 1e-3 * step_s, 100.0 * step_s),
        ] {
            values.set(parameter, values.of(parameter).clamp(low, high));
        }
        values
    }

    /// Largest force in the records, in N.
    fn force_n(&self, values: &Values) -> f64 {
        let volts = self.records.iter().flat_map(|fitted| &fitted.record.command);
        let most_v = volts.fold(0.0, |most: f64, volt| most.max(volt.abs()));
        values.of(Parameter::Gain).abs() * most_v
    }
}

/// The parameter that the record shows least. It has the largest component along the direction about which the record
/// has the least information.
fn weakest(jacobian: &DMatrix<f64>) -> Option<usize> {
    let mut scaled = jacobian.clone();
    for mut column in scaled.column_iter_mut() {
        let norm = column.norm().max(f64::MIN_POSITIVE);
        column.unscale_mut(norm);
    }
    let svd = scaled.qr().unpack_r().svd(false, true);
    let axes = svd.v_t?;
    let weak = axes.row(svd.singular_values.imin());
    Some(weak.transpose().iamax())
}

/// The smallest reduction of the sum of squares that is significant, divided by the mean square. The noise is taken as
/// white.
fn enough() -> f64 {
    Normal::standard().inverse_cdf(FAMILY_P / Term::ALL.len() as f64).powi(2)
}
