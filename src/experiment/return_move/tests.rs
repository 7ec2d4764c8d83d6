use super::*;

pub use crate::design::tests::DESIGN;
pub const SETTINGS: ReturnSettings = ReturnSettings::SOFT;

struct Moving {
    plan: ReturnPlan,
    back: Return,
}

impl Moving {
    fn new(plan: ReturnPlan) -> Self {
        Self { plan, back: Return::default() }
    }

    fn output(&mut self, position: Position, contact: bool) -> ReturnStep {
        self.back.output(&self.plan, position, contact)
    }
}

/// A simulated handle on a spring, which is relaxed at `rest_m`.
pub struct Handle {
    pub mass_kg: f64,
    pub damping: f64,
    pub spring: f64,
    pub rest_m: f64,
    pub x: f64,
    pub v: f64,
}

impl Handle {
    /// The paper's handle, at `x`.
    pub fn at(x: f64) -> Self {
        Self { mass_kg: 0.416, damping: 5.5195, spring: 11.0626, rest_m: 0.0517, x, v: 0.0 }
    }

    pub fn position(&self) -> Position {
        #[expect(clippy::cast_possible_truncation, reason = "a metre at most")]
        Position::from_counts((self.x / 1e-6).floor() as i32)
    }

    /// Moves the handle for one output period under this force.
    pub fn go(&mut self, force: Force) {
        for _ in 0..10 {
            let force = f64::from(force.bits()) / 2f64.powi(30) * DESIGN.full_scale_n;
            let spring = self.spring * (self.x - self.rest_m);
            self.v += (force - spring - self.damping * self.v) / self.mass_kg * 1e-4;
            self.x += self.v * 1e-4;
        }
    }
}

/// Brings the handle back. Returns the last step, the number of outputs, the highest speed, and the largest force as a
/// part of full scale.
fn bring_back(mut handle: Handle, held: bool) -> (ReturnStep, u32, f64, f64) {
    let mut back = Moving::new(SETTINGS.build(&DESIGN).unwrap());
    let (mut fastest, mut strongest) = (0f64, 0f64);
    for outputs in 0.. {
        match back.output(handle.position(), false) {
            ReturnStep::Push(force) => {
                strongest = strongest.max(f64::from(force.bits()).abs() / 2f64.powi(30));
                if !held {
                    handle.go(force);
                }
            }
            end => {
                assert!(end == ReturnStep::TooLong || handle.x.abs() < 6e-5, "{}", handle.x);
                return (end, outputs, fastest, strongest);
            }
        }
        fastest = fastest.max(handle.v.abs());
    }
    unreachable!()
}

#[test]
fn it_comes_back_slowly_from_either_side_and_from_the_start_itself() {
    let starts: &[f64] = if cfg!(miri) { &[-0.01] } else { &[0.07, 0.0517, 0.01, 0.0, -0.03] };
    for &from_m in starts {
        let (end, outputs, fastest, strongest) = bring_back(Handle::at(from_m), false);
        assert_eq!(end, ReturnStep::Arrived, "{from_m}");
        assert!(outputs < 2_000, "{from_m}: {outputs}");
        assert!(fastest < 0.25, "{from_m}: {fastest}");
        assert!(strongest <= 1.4 / 5.906 + 1e-9);
    }
}

#[test]
#[cfg_attr(miri, ignore = "six returns in closed loop")]
fn light_heavy_and_undamped_handles_come_back_as_well() {
    for mass_kg in [0.05, 0.4, 2.0] {
        for (damping, spring) in [(0.5, 0.0), (5.0, 11.0)] {
            let handle = Handle { mass_kg, damping, spring, ..Handle::at(0.07) };
            let (end, outputs, fastest, _) = bring_back(handle, false);
            assert_eq!(end, ReturnStep::Arrived, "{mass_kg} {damping}");
            assert!(outputs < 4_000 && fastest < 0.3, "{mass_kg} {outputs} {fastest}");
        }
    }
}

#[test]
#[cfg_attr(miri, ignore = "10 s in steps of 1 ms")]
fn a_handle_that_is_held_ends_it_and_never_feels_more_than_the_limit() {
    let (end, outputs, _, strongest) = bring_back(Handle::at(0.05), true);
    assert_eq!((end, outputs), (ReturnStep::TooLong, 10_000));
    assert!(strongest <= 1.4 / 5.906 + 1e-9);
}

/// A hand brings the handle to the start faster than the return would. The hand lets go at once, or holds the handle
/// there for a moment. The handle stays there, except for the motion by its own spring.
#[test]
#[cfg_attr(miri, ignore = "returns in closed loop")]
fn a_handle_that_a_hand_has_brought_to_the_start_is_not_driven_away() {
    for (mass_kg, spring) in [(0.416, 0.0), (0.05, 0.0), (0.416, 11.0626)] {
        for (from_m, to_m) in [(0.05, 0.0), (-0.03, 0.0), (0.05, 0.005)] {
            for (outputs, wait) in [(100, 0), (500, 0), (100, 15), (500, 300)] {
                let mut handle = Handle { mass_kg, spring, ..Handle::at(from_m) };
                let mut back = Moving::new(SETTINGS.build(&DESIGN).unwrap());
                let (mut farthest, mut fastest, mut arrived) = (0f64, 0f64, false);
                for n in 0..6_000 {
                    let ReturnStep::Push(force) = back.output(handle.position(), false) else {
                        arrived = true;
                        break;
                    };
                    if n < outputs + wait {
                        let part = f64::from(n.min(outputs)) / f64::from(outputs);
                        (handle.x, handle.v) = (from_m + (to_m - from_m) * part, 0.0);
                        continue;
                    }
                    handle.go(force);
                    farthest = farthest.max(handle.x.abs() - to_m);
                    fastest = fastest.max(handle.v.abs());
                }
                let case = std::format!(
                    "{mass_kg} kg, {spring} N/m, {from_m} to {to_m} m, {outputs} + {wait}"
                );
                assert!(arrived, "{case}");
                let sag = 2.5e-3 * spring / 11.0626;
                // For eight outputs the damper still measures the speed that the hand gave the handle, so it brakes.
                assert!(farthest < 1.5e-3 + sag, "{case}: {farthest} m away");
                assert!(fastest < 0.25, "{case}: {fastest} m/s");
            }
        }
    }
}

#[test]
#[cfg_attr(miri, ignore = "returns in closed loop")]
fn a_return_that_is_taken_starts_and_one_that_cannot_start_is_refused_with_the_range() {
    let stiff = |stiffness_n_per_m| ReturnSettings { stiffness_n_per_m, ..SETTINGS };
    let error = stiff(9_400.0).build(&DESIGN).unwrap_err();
    assert_eq!(error.parameter, "return_stiffness_n_per_m");
    let most = *error.range.end();
    assert!((9_300.0..9_334.0).contains(&most), "{error}");
    for settings in
        [stiff(most), ReturnSettings { force_n: 0.006, speed_m_per_s: 0.01, ..stiff(600.0) }]
    {
        for resolution_m in [1e-6, 7.3e-6, 1e-7] {
            let design = Design { resolution_m, ..DESIGN };
            let settings = ReturnSettings { tolerance_m: 5e-5, ..settings };
            let mut back = Moving::new(settings.build(&design).unwrap());
            #[expect(clippy::cast_possible_truncation, reason = "half a metre")]
            let at = Position::from_counts((0.05 / resolution_m) as i32);
            let moved = (0..20).any(
                |_| matches!(back.output(at, false), ReturnStep::Push(force) if force.bits() < 0),
            );
            assert!(moved, "{settings:?} {resolution_m}");
        }
    }
}

/// Here the step of the reference r is rounded up to a whole number of counts, which is also the lead. r must take this
/// step in both directions.
#[test]
fn a_step_as_long_as_the_lead_is_taken_on_either_side() {
    let full_scale_n = 2.189_657_517_033_622;
    let design = Design { rate_hz: 5e4, resolution_m: 1e-8, full_scale_n, period: 42, ..DESIGN };
    let settings = ReturnSettings {
        speed_m_per_s: 1.0,
        force_n: 1e-3 * full_scale_n,
        stiffness_n_per_m: 2.606_735_139_325_740_7,
        ..SETTINGS
    };
    for at in [-1_000_000, 1_000_000] {
        let mut back = Moving::new(settings.build(&design).unwrap());
        let step = back.output(Position::from_counts(at), false);
        assert!(
            matches!(step, ReturnStep::Push(force) if force.bits() * at.signum() < 0),
            "{step:?} at {at}"
        );
    }
}

#[test]
fn in_the_wall_it_only_pulls_out() {
    let mut back = Moving::new(SETTINGS.build(&DESIGN).unwrap());
    for _ in 0..100 {
        let ReturnStep::Push(force) = back.output(Position::from_counts(-20_000), true) else {
            panic!("it is not back yet");
        };
        assert!(force.bits() <= 0, "{force:?}");
    }
}

#[test]
fn what_cannot_be_is_refused_by_name() {
    let named = |settings: ReturnSettings| settings.build(&DESIGN).unwrap_err().parameter;
    let base = SETTINGS;
    assert_eq!(named(ReturnSettings { force_n: 3.0, ..base }), "return_force_n");
    assert_eq!(named(ReturnSettings { start_m: f64::NAN, ..base }), "start_m");
    assert_eq!(named(ReturnSettings { tolerance_m: 1e-6, ..base }), "return_tolerance_m");
    assert_eq!(named(ReturnSettings { speed_m_per_s: 0.0, ..base }), "return_speed_m_per_s");
}

#[test]
fn settings_become_counts_outputs_and_parts_of_full_scale() {
    let plan = ReturnSettings { start_m: 0.05, ..SETTINGS }.build(&DESIGN).unwrap();
    assert_eq!(plan.start(), Position::from_counts(50_000));
    // 1.4 N over 300 N/m are 4666.7 um
    assert_eq!((plan.lead, plan.rest_outputs, plan.timeout_outputs), (4_667, 20, 10_000));
    assert!((f64::from(plan.force().bits()) / 2f64.powi(30) - 1.4 / 5.906).abs() < 1e-9);
    // The speed is measured over the last eight milliseconds at every period, also at 0.1 ms.
    for (period, pace) in [(10, 1), (5, 2), (2, 5), (1, 10)] {
        let faster = SETTINGS.build(&Design { period, ..DESIGN }).unwrap();
        assert_eq!((faster.pace, faster.damping), (pace, plan.damping));
    }
}

/// On this device a newton is 10^6 LSB and a count is a micrometre, so 1 N/m is 1 LSB per count. This makes the ends of
/// the ranges easy to see.
#[test]
fn a_setting_out_of_range_is_refused_with_the_range() {
    let design = Design { full_scale_n: f64::from(1 << 30) * 1e-6, ..DESIGN };
    let base = ReturnSettings { force_n: 10.0, ..SETTINGS };
    let gain = 2f64.powi(50);
    for (settings, name, low, high) in [
        (ReturnSettings { force_n: 1.0, ..base }, "return_force_n", 1.073_741_824, 536.870_912),
        (ReturnSettings { tolerance_m: 2.0, ..base }, "return_tolerance_m", 4e-6, 1.048_576),
        // A damping gain cannot be so small. The next smaller allowed damping is 0.
        (
            ReturnSettings { damping_n_s_per_m: 1e-13, ..base },
            "return_damping_n_s_per_m",
            0.0,
            gain * 0.008,
        ),
        (
            ReturnSettings { integral_n_per_m_s: 1e-13, ..base },
            "return_integral_n_per_m_s",
            0.0,
            gain * 1000.0,
        ),
    ] {
        let error = settings.build(&design).unwrap_err();
        assert_eq!(error.parameter, name);
        for (end, expected) in [(*error.range.start(), low), (*error.range.end(), high)] {
            assert!((end - expected).abs() <= 1e-9 * expected, "{error}");
        }
    }
}

#[test]
fn it_ends_at_a_start_that_is_not_zero() {
    for start_m in [0.012, -0.012] {
        let mut back = Moving::new(ReturnSettings { start_m, ..SETTINGS }.build(&DESIGN).unwrap());
        let mut handle = Handle { spring: 0.0, ..Handle::at(0.8 * start_m) };
        let arrived = (0..2_000).any(|_| match back.output(handle.position(), false) {
            ReturnStep::Push(force) => {
                handle.go(force);
                false
            }
            end => end == ReturnStep::Arrived,
        });
        assert!(arrived && (handle.x - start_m).abs() < 6e-5, "{start_m}: {}", handle.x);
    }
}

/// r moves in steps of 150 um. Within the lead of 4667 um there are 31 steps. They stretch the spring of 300 N/m by
/// 4650 um.
#[test]
fn a_handle_that_is_held_stretches_the_spring_by_the_steps_that_fit_the_lead() {
    let settings = ReturnSettings { damping_n_s_per_m: 0.0, integral_n_per_m_s: 0.0, ..SETTINGS };
    for (at, newtons) in [(50_000, -1.395), (-50_000, 1.395)] {
        let mut back = Moving::new(settings.build(&DESIGN).unwrap());
        let last = (0..100).map(|_| back.output(Position::from_counts(at), false)).last();
        let Some(ReturnStep::Push(force)) = last else { panic!("{last:?}") };
        let given = f64::from(force.bits()) / 2f64.powi(30) * DESIGN.full_scale_n;
        assert!((given - newtons).abs() < 5e-4, "{given} N at {at}");
    }
}

/// The handle jumps from the start to the other end of the count's range. This distance needs 33 bits.
#[test]
fn the_farthest_jump_is_pulled_back_from_with_all_its_force() {
    for (start, jump) in [(1 << 30, i32::MIN), (-(1 << 30), i32::MAX)] {
        let start_m = f64::from(start) * DESIGN.resolution_m;
        let plan = ReturnSettings { start_m, ..SETTINGS }.build(&DESIGN).unwrap();
        let mut back = Moving::new(plan);
        back.output(Position::from_counts(start), false);
        let limit = plan.force().bits();
        let toward = Force::saturating_from_bits(if jump < 0 { limit } else { -limit });
        let step = back.output(Position::from_counts(jump), false);
        assert_eq!(step, ReturnStep::Push(toward));
    }
}

/// On this device a Ki of 1000 N/(m s) is 1 LSB per count and output. So an error of 1000 counts moves the integral by
/// 1000 at each output.
#[test]
fn against_a_hand_that_is_stronger_than_the_limit_the_integral_only_gets_smaller() {
    let design = Design { full_scale_n: f64::from(1 << 30) * 1e-6, ..DESIGN };
    let settings = ReturnSettings { force_n: 1.2, integral_n_per_m_s: 1e3, ..SETTINGS };
    let settings = ReturnSettings { stiffness_n_per_m: 5_000.0, ..settings };
    for (before, after) in [(1_500, 500), (600, -400), (500, 500), (400, 400), (-700, -700)] {
        let mut back = Moving::new(settings.build(&design).unwrap());
        back.output(Position::from_counts(0), false);
        back.back.integral = before;
        back.output(Position::from_counts(1_000), false);
        assert_eq!(back.back.integral, after, "from {before}");
    }
}

#[test]
fn a_handle_stands_while_it_stays_within_half_the_tolerance_of_one_place() {
    let settings = ReturnSettings { tolerance_m: 5.05e-5, ..SETTINGS };
    for (trembles, arrives) in [(25, Some(19)), (26, None)] {
        let mut back = Moving::new(settings.build(&DESIGN).unwrap());
        let ended = (0..200).find(|n| {
            let at = Position::from_counts(n % 2 * trembles);
            back.output(at, false) == ReturnStep::Arrived
        });
        assert_eq!(ended, arrives, "{trembles}");
    }
}
