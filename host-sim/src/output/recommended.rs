//! The recommended cutoff, as all outputs show it.

use serde::Serialize;

use crate::{
    notation::rounded,
    scene::{Criterion, NamedScene, Protocol, RmsOf, Units},
    study::{
        recommended::{AS_GOOD, FreeMotion, QuietStudy, Recommended},
        sweep::Ideal,
    },
};

/// The key `recommended` of a JSON object. It has the recommendation, or the reason why there is none.
#[derive(Clone, Debug, Serialize)]
pub struct Answer {
    recommended: Option<Row>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

#[derive(Clone, Debug, Serialize)]
struct Row {
    cutoff_hz: f64,
    range_hz: [f64; 2],
    criterion: &'static str,
    /// K and B of the stiffest wall that is stable.
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    /// Largest B of all walls.
    damping_max_n_s_per_m: f64,
    area_n2_s_per_m2: f64,
    is_capped: bool,
    reason: String,
    /// Lower end of the Z-width, where the handle moves freely.
    #[serde(skip_serializing_if = "Option::is_none")]
    free_motion: Option<FreeMotion>,
    protocols: Vec<ProtocolRow>,
}

/// Largest K at which a wall with this B is quiet in another protocol. `null` if no K is quiet, or if no test was made.
#[derive(Clone, Debug, Serialize)]
struct ProtocolRow {
    protocol: &'static str,
    stiffness_n_per_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    not_tried: Option<String>,
}

impl Answer {
    pub fn of(scene: &NamedScene, study: &QuietStudy) -> Self {
        match &study.recommended {
            Err(why) => Self { recommended: None, reason: Some(why.clone()) },
            Ok(of) => {
                let row = Row {
                    cutoff_hz: of.cutoff_hz,
                    range_hz: of.range_hz,
                    criterion: "quiet",
                    stiffness_n_per_m: of.stiffest.stiffness_n_per_m,
                    damping_n_s_per_m: of.stiffest.damping_n_s_per_m,
                    damping_max_n_s_per_m: of.damping_max_n_s_per_m,
                    area_n2_s_per_m2: of.area,
                    is_capped: of.is_cut,
                    reason: reason(scene.scene.units, study, of),
                    free_motion: study.free,
                    protocols: study
                        .protocols
                        .iter()
                        .map(|held| ProtocolRow {
                            protocol: held.protocol.name(),
                            stiffness_n_per_m: held.stiffness_n_per_m(),
                            not_tried: held.stiffest.clone().err(),
                        })
                        .collect(),
                };
                Self { recommended: Some(row), reason: None }
            }
        }
    }
}

fn reason(units: Units, study: &QuietStudy, of: &Recommended) -> String {
    let mut text = format!(
        "the largest area of quiet walls of {}, {}; as good means at least {} % of it",
        if let [_] = study.cutoffs[..] {
            "1 tried cutoff".into()
        } else {
            format!("{} tried cutoffs", study.cutoffs.len())
        },
        units.said(of.area, "N^2 s/m^2"),
        100.0 * AS_GOOD
    );
    let ends = match of.is_open {
        [false, false] => None,
        [true, false] => Some("below"),
        [false, true] => Some("above"),
        [true, true] => Some("at both ends"),
    };
    if let Some(ends) = ends {
        text += &format!("; the range may go on {ends}, where nothing was tried");
    }
    if of.is_cut {
        text += "; a cap of the walk cuts that area";
    }
    text
}

/// Sentences with the answer, its reason, and the next step.
pub fn sentences(scene: &NamedScene, study: &QuietStudy) -> Vec<String> {
    let (name, units) = (&scene.name, scene.scene.units);
    let of = match &study.recommended {
        Err(why) => return vec![format!("{name}: no cutoff to dial in: {why}")],
        Ok(of) => of,
    };
    let [low, high] = of.range_hz;
    let range =
        if low == high { String::new() } else { format!(" ({low} to {high} Hz are as good)") };
    let by = scene.scene.wall_hit.protocol.named();
    let by = by.map_or_else(String::new, |protocol| format!(" by {protocol}"));
    let dial_in = format!(
        "{name}: dial in {} Hz{range}. Walls are quiet{by} up to K = {} (with B = {}), and up to B = {}.",
        of.cutoff_hz,
        units.said(of.stiffest.stiffness_n_per_m, "N/m"),
        units.said(of.stiffest.damping_n_s_per_m, "N s/m"),
        units.said(of.damping_max_n_s_per_m, "N s/m"),
    );
    let next = format!(
        "Next: `cargo sim explain {name}` says what limits these walls, `cargo sim prepare` makes a board's record of a scene"
    );
    let has = format!("This cutoff has {}.", reason(units, study, of));
    let free = study.free.map(|free| {
        format!(
            "Free motion, the other end of the Z-width: {} {}, damping {}, dry friction {}; the output of the resting handle hums by {} RMS.",
            if units.is_rotary() { "inertia" } else { "mass" },
            units.said(free.mass_kg, "kg"),
            units.said(free.damping_n_s_per_m, "N s/m"),
            units.said(free.friction_n, "N"),
            units.said(free.hum_n, "N"),
        )
    });
    let elsewhere = by_protocols(units, study, of);
    [dial_in, has].into_iter().chain(elsewhere).chain(free).chain([next]).collect()
}

/// A sentence that says whether the stiffest wall is also quiet in the other protocols.
fn by_protocols(units: Units, study: &QuietStudy, of: &Recommended) -> Option<String> {
    let stiffness = of.stiffest.stiffness_n_per_m;
    let said = |protocol: Protocol| match protocol {
        Protocol::Paper => "a constant push",
        Protocol::Press => "a press of a minute",
        Protocol::Taps => "taps (two a second)",
        Protocol::Hand => "a hand that sways by 30 %",
    };
    let (_, factor) = units.written("N/m");
    let each = study.protocols.iter().map(|held| match &held.stiffest {
        Ok(Some(k)) if *k >= stiffness => format!("quiet by {}", said(held.protocol)),
        Ok(Some(k)) => {
            let k = k * factor;
            let near = rounded(k, 2);
            let most = if near > k { rounded(0.95 * k, 2) } else { near }; // at most the K that was tested
            format!(
                "by {} up to K = {} only",
                said(held.protocol),
                units.said(most / factor, "N/m")
            )
        }
        Ok(None) => format!("by {} at no K", said(held.protocol)),
        Err(why) => format!("by {} not tried: {why}", said(held.protocol)),
    });
    let each: Vec<String> = each.collect();
    (!each.is_empty()).then(|| {
        let b = units.said(of.stiffest.damping_n_s_per_m, "N s/m");
        format!(
            "The stiffest wall, B = {b}, tried in other ways (--protocol): {}.",
            each.join("; ")
        )
    })
}

/// A note if a cutoff is outside the recommended range. Otherwise `None`.
pub fn outside(study: &QuietStudy, cutoff_hz: f64) -> Option<String> {
    let [low, high] = study.recommended.as_ref().ok()?.range_hz;
    (!(low..=high).contains(&cutoff_hz)).then(|| {
        format!("{cutoff_hz} Hz is outside of {low} to {high} Hz, the cutoffs with the largest area of quiet walls")
    })
}

/// The result by the scene's own criterion. `None` if the recommendation has the same criterion.
pub fn by_its_own(scene: &NamedScene, ideal: Option<Ideal>) -> Option<String> {
    let hit = &scene.scene.wall_hit;
    let by = match (hit.criterion, hit.rms_of()) {
        (Criterion::Quiet, _) => return None,
        (Criterion::Rms, RmsOf::Counts) => {
            "the paper's criterion, which ignores the force".to_owned()
        }
        (criterion, _) => format!("the scene's own criterion, {}", criterion.name()),
    };
    Some(match ideal {
        None => format!("By {by}: no stable wall at any cutoff"),
        Some(Ideal { cutoff_hz, range_hz: [low, high], .. }) if low == high => {
            format!("By {by}: {cutoff_hz} Hz")
        }
        Some(Ideal { cutoff_hz, range_hz: [low, high], .. }) => {
            format!("By {by}: {cutoff_hz} Hz, range {low} to {high} Hz")
        }
    })
}
