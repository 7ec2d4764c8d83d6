//! Checks the tables for a board against the device. With a wrong value, the board cannot arm, or a fault always
//! occurs, or a fault never occurs. The core checks each value alone, because only the scene has mass and stops.
//! `prepare` reports the errors.

use zwidth::safety::SafetySettings;

use super::{Scene, element::Travel};
use crate::range::within;

impl Scene {
    /// Checks a board's values against the device. `is_measured` says that the device's values are measured. Only then
    /// the sign test is checked. Otherwise a person tries the sign test on the board.
    ///
    /// # Errors
    /// One line with key, value and allowed range, in the scene's units.
    pub fn check_fits(&self, is_measured: bool) -> Result<(), String> {
        let fits = self.travel_fits().and_then(|()| self.heaviest_fits());
        let fits = if is_measured { fits.and_then(|()| self.sign_test_fits()) } else { fits };
        fits.map_err(|line| self.units.text(&line))
    }

    /// The allowed travel must end before the rigid stops. Otherwise the board cannot detect a handle at a stop.
    fn travel_fits(&self) -> Result<(), String> {
        let Some(Travel::Rigid { low_m, high_m, .. }) = self.travel else { return Ok(()) };
        let (safety, count_m) = (self.on_board().safety, self.encoder.resolution_m);
        let first = "the rigid stops of [travel] come first: safety.travel";
        let low = low_m.min(-count_m)..=-count_m;
        let high = count_m..=high_m.max(count_m);
        within(&format!("{first}_low_m"), safety.travel_low_m, low)?;
        within(&format!("{first}_high_m"), safety.travel_high_m, high)
    }

    /// Mass and damping of the heaviest handle must be at least the mass and the damping of the device alone.
    fn heaviest_fits(&self) -> Result<(), String> {
        let (safety, device) = (self.on_board().safety, &self.device);
        let mass_kg = device.mass_kg + self.mode.map_or(0.0, |mode| mode.mass_kg);
        let key = |name: &str| format!("the device has more by itself: safety.heaviest_{name}");
        within(
            &key("mass_kg"),
            safety.heaviest_mass_kg,
            mass_kg..=*SafetySettings::HEAVIEST_MASS_KG.end(),
        )?;
        within(
            &key("damping_n_s_per_m"),
            safety.heaviest_damping_n_s_per_m,
            device.damping_n_s_per_m..=*SafetySettings::HEAVIEST_DAMPING_N_S_PER_M.end(),
        )
    }

    /// In the sign test the free handle must move by at least as many counts as the test must detect. Otherwise the
    /// board never arms.
    fn sign_test_fits(&self) -> Result<(), String> {
        let (safety, count_m) = (self.on_board().safety, self.encoder.resolution_m);
        let force = safety.sign_test_force;
        let moved = self.sign_test_m(force) / count_m;
        let least = *SafetySettings::SIGN_TEST_COUNTS.start();
        let free = format!("the free handle moves by {moved:.1} counts in the sign test");
        if moved >= least {
            let key = format!("{free}: safety.sign_test_counts");
            return within(&key, safety.sign_test_counts.into(), least..=moved.floor());
        }
        let most = *SafetySettings::SIGN_TEST_FORCE.end();
        let needed = force * least / moved;
        if needed <= most {
            return within(&format!("{free}: safety.sign_test_force"), force, needed..=most);
        }
        let finest = *zwidth::limits::RESOLUTION_M.start();
        let coarsest = self.sign_test_m(most) / least;
        within(&format!("{free}: encoder.resolution_m"), count_m, finest..=coarsest)
    }
}

#[cfg(test)]
mod tests {
    use crate::scene::{BUILT_IN, NamedScene};

    #[test]
    fn every_built_in_scene_and_every_example_fits_its_device() {
        let examples = ["handle", "known"].map(|name| format!("{name}.toml"));
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
        let examples = examples.map(|name| folder.join(name).to_str().unwrap().to_owned());
        let built_in = BUILT_IN.iter().map(|(name, _)| (*name).to_owned());
        for name in built_in.chain(examples) {
            let scene = NamedScene::load(&name).unwrap().scene;
            assert_eq!(scene.check_fits(true), Ok(()), "{name}");
        }
    }

    #[test]
    fn a_sign_test_that_needs_more_than_a_count_moves_says_what_would_do() {
        let of = |force: f64, count_m: f64| {
            let mut scene = NamedScene::load("nucleo-f446re").unwrap().scene;
            scene.encoder.resolution_m = count_m;
            let safety = scene.safety.as_mut().unwrap();
            (safety.sign_test_force, safety.sign_test_counts) = (Some(force), None);
            assert_eq!(scene.check_fits(false), Ok(()), "a starter is tried");
            scene.check_fits(true).unwrap_err()
        };
        assert_eq!(
            of(0.01, 2e-5),
            "the free handle moves by 8.9 counts in the sign test: safety.sign_test_force is 0.01, allowed 0.0112698951 to 0.05"
        );
        assert_eq!(
            of(0.05, 1e-4),
            "the free handle moves by 8.9 counts in the sign test: encoder.resolution_m is 0.0001, allowed 0.00000001 to \
             0.0000887319711"
        );
    }
}
