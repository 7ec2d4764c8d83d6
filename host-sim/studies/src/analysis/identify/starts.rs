//! First values from which the search fits a model with one more term.

use levenberg_marquardt::LeastSquaresProblem as _;
use nalgebra::DMatrix;

use super::{
    cogs, cycle,
    fit::Fitted,
    guess,
    layout::{Layout, Parameter, Values},
    search::{EncoderStep, FAST_ROWS, Model, STARTS_TAKEN, Search},
    terms::Term,
};

/// First values that are tried for the friction, as shares of the largest force.
const FRICTION_STARTS: [f64; 3] = [0.02, 0.08, 0.2];
/// First values that are tried for the lag, in rows.
const LAG_STARTS: [f64; 2] = [0.5, 3.0];
/// First values that are tried for the Stribeck curve. `FALLS` has Stribeck speeds, as shares of the largest speed over
/// [`FAST_ROWS`]. `RISE` is the rise, as a share of Coulomb friction.
const FALLS: [f64; 4] = [0.01, 0.03, 0.1, 0.3];
const RISE: f64 = 0.2;
/// Strides with which the search looks for cogging, in rows.
const STRIDES_OF_COGS: [usize; 4] = [2, 8, 32, 128];
/// Number of pitches that are tried for each stride.
const LINES_OF_COGS: usize = 2;
/// Largest friction after a step of the search, as a share of the largest force.
const FRICTION_MOST: f64 = 0.5;

impl Search<'_> {
    /// First values of a fit with this term, at most [`STARTS_TAKEN`]. `start` has a place for the term.
    pub(super) fn starts(&self, term: Term, start: &Values) -> Vec<Values> {
        let shares = |parameter: Parameter, unit: f64, shares: &[f64]| {
            let of = |share: &f64| {
                let mut start = start.clone();
                start.set(parameter, share * unit);
                start
            };
            shares.iter().map(of).collect::<Vec<_>>()
        };
        let mut starts = if term == Term::Stribeck {
            self.stribeck_starts(start)
        } else {
            let step = self.linear_step(start).map(|(step, _)| self.bounded(step));
            step.into_iter().collect()
        };
        match term {
            Term::Friction => {
                let windows = guess::WINDOWS.into_iter();
                starts.extend(windows.filter_map(|windows| self.in_motion(start, windows)));
                let force_n = self.force_n(start);
                starts.extend(shares(Parameter::Friction, force_n, &FRICTION_STARTS));
            }
            Term::Amplifier => {
                let step_s = self.records[0].record.step_s;
                starts.extend(shares(Parameter::Lag, step_s, &LAG_STARTS));
            }
            Term::Stribeck | Term::Offset | Term::Cogging | Term::Phase => {}
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
        starts.into_iter().take(STARTS_TAKEN).map(|(_, start)| start).collect()
    }

    /// The model with an encoder's error of the cycle that promises the largest reduction of the sum of squares.
    pub(super) fn of_encoder(&self, model: &Model) -> Option<EncoderStep> {
        let residual = (model.solution.residual_m.as_slice(), model.weighed.unit_m);
        let lines = match self.options.cycle_m {
            Some(cycle_m) => vec![cycle::Line { cycles_per_m: 1.0 / cycle_m, looked_at: 1.0 }],
            None => cycle::strongest(self.records, residual),
        };
        let steps = lines.into_iter().filter_map(|line| {
            let more = Layout {
                terms: Term::Phase.add(model.layout().terms, true),
                cycles_per_m: Some(line.cycles_per_m),
                ..*model.layout()
            };
            let (values, gain) = self.linear_step(&model.values().within(more))?;
            Some(EncoderStep { values, gain, looked_at: line.looked_at })
        });
        steps.max_by(|a, b| a.gain.total_cmp(&b.gain))
    }

    /// Pitches of cogging that the missing force follows. Several strides are tried. A long stride averages over short
    /// pitches. With a short stride, noise hides the force.
    pub(super) fn of_motor(&self, model: &Model) -> Vec<cogs::Line> {
        let pieces = model.weighed.pieces();
        let strides = STRIDES_OF_COGS.into_iter();
        let lines = strides.flat_map(|stride| {
            let weighting = self.force(model, stride);
            let forces = pieces.iter().enumerate().map(|(record, piece)| {
                let mut own = weighting.weighed(record, piece.residual.to_vec());
                // Each force is a mean with triangular weights. The middle of these weights is one stride before the
                // row.
                own.drain(..own.len().min(stride));
                own.resize(piece.residual.len(), 0.0);
                own
            });
            let forces: Vec<Vec<f64>> = forces.collect();
            let seen = (stride, model.weighed.unit_m);
            cogs::strongest(self.records, &forces, seen, LINES_OF_COGS)
        });
        lines.collect()
    }

    /// First values of a fit with a Stribeck curve.
    fn stribeck_starts(&self, start: &Values) -> Vec<Values> {
        let of = |mut values: Values| {
            values.set(Parameter::Rise, RISE * values.of(Parameter::Friction));
            let step = self.linear_step(&values).map(|(step, _)| step);
            step.filter(Values::is_allowed).unwrap_or(values)
        };
        self.falls(start).into_iter().map(of).collect()
    }

    /// The values with each Stribeck speed of [`FALLS`].
    pub(super) fn falls(&self, values: &Values) -> Vec<Values> {
        let fastest =
            self.records.iter().flat_map(|Fitted { record, positions_m, first, .. }| {
                let rows = positions_m[*first..].windows(FAST_ROWS + 1);
                rows.map(|rows| {
                    (rows[FAST_ROWS] - rows[0]).abs() / (FAST_ROWS as f64 * record.step_s)
                })
            });
        let fastest = fastest.fold(0.0, f64::max);
        let of = |part: f64| {
            let mut values = values.clone();
            values.set(Parameter::Fall, part * fastest);
            values
        };
        FALLS.into_iter().map(of).collect()
    }

    /// The values after one Gauss-Newton step, and the expected reduction of the sum of squares.
    pub(super) fn linear_step(&self, values: &Values) -> Option<(Values, f64)> {
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
    pub(super) fn force_n(&self, values: &Values) -> f64 {
        let volts = self.records.iter().flat_map(|fitted| &fitted.record.command);
        let most_v = volts.fold(0.0, |most: f64, volt| most.max(volt.abs()));
        values.of(Parameter::Gain).abs() * most_v
    }
}
