//! Widens the intervals by what a record can neither show nor exclude.
//!
//! A hidden term is a term that the model lacks and that the device may have: friction, its fall with the speed, a lag,
//! or an offset. The record limits the size of a hidden term only so far. If a term of this size could move a value far
//! outside of the value's interval, the interval is widened.
//!
//! Where the model has kinks, or where two parameters stand in for each other, the parameters that explain a record
//! equally well lie along a curve. So a parameter is moved in steps, and all others are fitted again (profile
//! likelihood).

use nalgebra::DMatrix;

use super::{
    confidence::{self, Estimate, Hidden},
    fit,
    layout::{Layout, Values},
    search::{Model, Search, candidates},
    terms::{Term, Terms},
};

/// Largest number of times that the change of a parameter along the profile of the likelihood is doubled.
const PROFILE_STEPS: usize = 14;
/// First change of a term that is not in the model, as a share of its unit: the largest force, or 100 rows. The first
/// change of a parameter of the model is a half-width.
const SMALL_TERM: f64 = 1e-4;
const LAG_ROWS: f64 = 100.0;

/// A term that is not in the model.
struct Candidate {
    term: Term,
    /// The model's values, and a place for the term.
    values: Values,
    place: usize,
    /// First change along the profile.
    by: f64,
    hidden: Hidden,
}

impl Search<'_> {
    /// Widens the intervals because of terms that the record can neither show nor exclude.
    pub(super) fn widen(&self, model: &mut Model) -> Result<(), String> {
        if self.options.terms != Terms::Auto {
            return Ok(());
        }
        let mut candidates = self.hidden(model);
        let mut hidden: Vec<&mut Hidden> =
            candidates.iter_mut().map(|one| &mut one.hidden).collect();
        let given = (&model.weighed, &self.weighting);
        model.estimates =
            confidence::estimates(&model.solution, given, &mut hidden, self.records[0].stop)?;
        // Of the curves of one term, the profile of the one that moves the values furthest is enough.
        candidates.sort_by(|a, b| b.hidden.widens.total_cmp(&a.hidden.widens));
        let is_widened = candidates.iter().any(|one| one.hidden.widens > 0.0);
        let mut done = vec![];
        for Candidate { term, values, place, by, hidden } in candidates {
            if hidden.widens > 0.0 {
                model.estimates.hidden = term.add(model.estimates.hidden, true);
            }
            // The first change of a force may be in a place where its effect is small.
            let is_force = matches!(term, Term::Friction | Term::Offset);
            if (hidden.widens > 0.0 || is_widened && is_force) && !done.contains(&term) {
                self.profile(model, &values, (place, by, hidden.most));
                done.push(term);
            }
        }
        Ok(())
    }

    fn hidden(&self, model: &Model) -> Vec<Candidate> {
        let layout = *model.layout();
        let force_n = self.force_n(model.values());
        // A larger offset would move a handle at rest. Static friction is at most twice Coulomb friction.
        let [friction_n, _] = model.values().slow();
        let most_n = if layout.terms.friction { friction_n } else { f64::INFINITY };
        let lag_s = LAG_ROWS * self.records[0].record.step_s;
        let sizes = |term: Term| match term {
            Term::Friction => Some((force_n, f64::INFINITY)),
            Term::Offset | Term::Stribeck => Some((force_n, most_n)),
            // A latency that is fitted stands in for a lag.
            Term::Amplifier => layout.latency_s.map(|_| (lag_s, lag_s)),
            Term::Cogging | Term::Phase => None,
        };
        let is_open = |term: &Term| {
            !term.is_in(layout.terms) && (*term != Term::Stribeck || layout.terms.friction)
        };
        let open = candidates(&layout).into_iter().filter(is_open);
        let sized = open.filter_map(|term| Some((term, sizes(term)?)));
        let all = sized.flat_map(|(term, (unit, most))| {
            let with = Layout { terms: term.add(layout.terms, true), ..layout };
            let values = model.values().within(with);
            let starts = match term {
                Term::Stribeck => self.falls(&values),
                _ => vec![values],
            };
            starts.into_iter().filter_map(move |values| {
                let place = values.layout().place(term.parameter())?;
                let by = self.problem(values.clone()).by(term.parameter())?;
                let hidden = Hidden { left: model.without(&by), by, most, widens: 0.0 };
                Some(Candidate { term, values, place, by: SMALL_TERM * unit, hidden })
            })
        });
        all.collect()
    }

    /// Widens the intervals by the profile of the likelihood. With friction the model has kinks. So the sets of
    /// parameters that explain a record lie along a curve. Derivatives at one point do not show this curve. So the
    /// parameter with the largest uncertainty is changed in steps, and all other parameters are fitted again. Each
    /// interval is widened to contain all values that explain the record as well as the fitted values.
    pub(super) fn hold_profile(&self, model: &mut Model) {
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
        // What is hidden has widened the interval: further on along the curve, the fit may be as good again.
        let Estimate { half_width, white_half_width, .. } = model.estimates.mass;
        let widening = model.estimates.widening.max(half_width / white_half_width);
        let room = squares * (confidence::quantile() * widening).powi(2);
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
