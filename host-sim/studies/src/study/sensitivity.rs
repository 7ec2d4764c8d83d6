//! Shows how much the ideal cutoff depends on the assumptions of a study.
//!
//! The ideal cutoff does not depend on the device alone. The ideal cutoff also depends on five assumptions: the RMS
//! limit, whether the wall may pull, the latency, the output rate, and the impact speed. Each variant changes one
//! assumption. Each variant is walked with a push by motor and with a push by hand.

use crate::{
    error::Error,
    scene::{PushBy, Scene},
    simulation::prepared::PreparedScene,
};

/// A scene in which one assumption is changed.
#[derive(Clone, Debug)]
pub struct Variant {
    /// Short name, used in files.
    pub name: String,
    /// Description of the change for a reader.
    pub change: String,
    pub prepared: PreparedScene,
}

/// The variants of a scene. A variant without a change is left out, for example half of an odd period. A variant that
/// the scene does not accept is also left out, for example twice a latency of 600 samples.
///
/// # Errors
/// A variant's value is out of range.
pub fn variants(scene: &Scene) -> Result<Vec<Variant>, Error> {
    let mut variants = vec![];
    let (push_by, other, who) = match scene.wall_hit.push_by {
        PushBy::Motor => (PushBy::Hand, "by_hand", "a hand pushes"),
        PushBy::Hand => (PushBy::Motor, "by_motor", "the motor pushes"),
    };
    let mut add = |name: &str, change: String, edit: &dyn Fn(&mut Scene)| {
        let mut changed = scene.clone();
        edit(&mut changed);
        if name != other && changed == *scene || changed.check().is_err() {
            return Ok(());
        }
        let prepared = PreparedScene::new(&changed)?;
        if name != other {
            variants.push(Variant { name: name.into(), change: change.clone(), prepared });
        }
        // With the same force, a free handle also reaches the wall.
        changed.wall_hit.push_by = push_by;
        if scene.arm.is_none() && changed.check().is_ok() {
            let (name, change) = match name == other {
                true => (other.to_owned(), change),
                false => (format!("{name}_{other}"), format!("{change}, {who}")),
            };
            variants.push(Variant { name, change, prepared: PreparedScene::new(&changed)? });
        }
        Ok::<(), Error>(())
    };
    add(other, who.into(), &|_| ())?;
    let (limit_m, units) = (scene.wall_hit.rms_limit_m, scene.units);
    for (name, factor) in [("rms_limit_third", 1.0 / 3.0), ("rms_limit_double", 2.0)] {
        let rms_limit_m = limit_m * factor;
        let [changed, own] = [rms_limit_m, limit_m].map(|limit| units.said(1e6 * limit, "um"));
        let change = format!("RMS limit {changed} instead of {own}");
        add(name, change, &|scene| scene.wall_hit.rms_limit_m = rms_limit_m)?;
    }
    let pulls = if scene.wall.push_only { "the wall may pull" } else { "the wall never pulls" };
    add("push_only_flipped", pulls.into(), &|scene| scene.wall.push_only = !scene.wall.push_only)?;
    let latency = scene.actuator.latency;
    for (name, factor) in [("latency_half", 0.5), ("latency_double", 2.0)] {
        let changed = latency * factor;
        let change = format!("latency {changed} samples instead of {latency}");
        add(name, change, &|scene| scene.actuator.latency = changed)?;
    }
    let period = scene.actuator.period;
    let halved = if period.is_multiple_of(2) { period / 2 } else { period };
    let change = format!("an output every {halved} samples instead of {period}, same latency");
    add("output_rate_double", change, &|scene| scene.actuator.period = halved)?;
    let (start_m, wall_m) = (scene.device.start_position_m, scene.wall.position_m);
    let closer_m = wall_m - (wall_m - start_m) / 2.0;
    let [closer, start] = [closer_m, start_m].map(|at| units.said(at, "m"));
    let change = format!("slower impact: start at {closer} instead of {start}");
    add("slower_impact", change, &|scene| scene.device.start_position_m = closer_m)?;
    Ok(variants)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    #[test]
    fn each_variant_changes_one_thing_and_impossible_ones_are_left_out() {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        let names = |scene: &Scene| {
            variants(scene).unwrap().into_iter().map(|v| v.name).collect::<Vec<_>>()
        };
        assert_eq!(names(&scene).len(), 15);
        let by_hand = names(&scene).iter().filter(|name| name.ends_with("by_hand")).count();
        assert_eq!(by_hand, 8);
        let all = variants(&scene).unwrap();
        let find = |name| all.iter().find(|v| v.name == name).unwrap().prepared.scene().clone();
        assert!((find("rms_limit_third").wall_hit.rms_limit_m - 5e-6).abs() < 1e-18);
        assert_eq!(find("latency_half").actuator.latency, 5.0);
        assert_eq!(find("output_rate_double").actuator.period, 5);
        assert_eq!(find("slower_impact").device.start_position_m, 0.035);
        assert!(!find("push_only_flipped").wall.push_only);
        scene.actuator.period = 3; // twice the rate would need a period of 1.5 samples
        assert!(!names(&scene).iter().any(|name| name == "output_rate_double"));
        scene.actuator.latency = 600.0;
        assert!(!names(&scene).iter().any(|name| name == "latency_double"));
        scene.actuator.latency = 0.0;
        assert_eq!(names(&scene).iter().filter(|name| name.starts_with("latency")).count(), 0);
    }
}
