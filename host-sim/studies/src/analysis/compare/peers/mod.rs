//! Velocity estimators of other systems with their default settings. They run in the core's arithmetic at the scene's
//! rate. They are not tuned.
//!
//! Poles and zeros in the z-plane are equal to the poles and zeros of the source. Each tracking loop has two rows. In
//! one row the velocity is read before the step. In the other row the velocity is read as in the source. The rows
//! differ by a delay of one sample, which matters if other delays are small. Changes that these systems make to a count
//! before the estimate are not included. For example, ODrive floors its estimate and sets small speeds to zero. The
//! systems' own rates, 1 to 30 kHz, are not included either.

mod table;

use std::f64::consts::PI;

use rayon::prelude::*;
use zwidth::{VelocitySettings, velocity::RATIO};

use super::with_filter;
use crate::{
    error::Error,
    scene::{NamedScene, RmsOf, Scene, Walk, velocity::describe},
    simulation::prepared::Numeric,
    study::{
        How,
        boundary::Boundaries,
        limits::{Limit, LimitResult, Question, Situation, limits},
        limits_asked::{LimitAsked, Names, check, finer},
        loops::boards,
        sweep::filters,
    },
};

pub use table::PeerArea;

/// Default limits of a stable hit, in the form that a user types.
pub const LIMITS: &str = "quiet,15e-6,1e-6,felt";
/// Cutoffs at which the scene's own estimator is compared, in Hz. The lower cutoff suits a limit at which a faint hum
/// is felt. The higher cutoff suits the limit of the paper.
const OWN_HZ: [f64; 2] = [500.0, 1500.0];

/// A default velocity estimator of another system.
#[derive(Clone, Copy, Debug)]
pub struct Peer {
    pub name: &'static str,
    pub does: &'static str,
    /// Source of this default, for example a page or a file of the system.
    pub source: &'static str,
    /// Gives the estimator's settings for a rate in Hz. `None` if the estimator is unstable at this rate.
    settings: fn(f64) -> Option<VelocitySettings>,
}

/// A low-pass with these two poles of the z-plane. The slower pole comes first.
fn poles([slow, fast]: [f64; 2], rate_hz: f64) -> Option<VelocitySettings> {
    let cutoff_hz = -slow.ln() * rate_hz / (2.0 * PI);
    let ratio = (fast.ln() / slow.ln()).clamp(*RATIO.start(), *RATIO.end()); // no second pole: infinite
    Some(VelocitySettings::Smoothing { cutoff_hz, ratio })
}

/// A tracking loop with `kp = 2 w` and `ki = w^2` that is computed in explicit steps. Both poles are at `1 - w T`.
/// `lead` is in samples.
fn tracking(w: f64, lead: f64, rate_hz: f64) -> Option<VelocitySettings> {
    let bandwidth_hz = -(1.0 - w / rate_hz).ln() * rate_hz / (2.0 * PI);
    (w < rate_hz).then_some(VelocitySettings::TrackingLead { bandwidth_hz, lead })
}

/// The loop of `tracking` with a predicted position in the comparison. Because of the prediction the two poles differ.
fn predicting(w: f64, rate_hz: f64) -> Option<VelocitySettings> {
    let g = w / rate_hz;
    let middle = 1.0 - g - g * g / 2.0;
    let apart = (middle * middle - (1.0 - 2.0 * g)).sqrt();
    let both = [middle + apart, middle - apart];
    if both[1] > 0.0 { poles(both, rate_hz) } else { None }
}

/// Lead of a velocity that is read one sample late, in samples.
const LATE: f64 = -1.0;
/// The default of moteus: `pll_filter_hz` is 400. Here it is in rad/s.
const MOTEUS_W: f64 = 2.0 * PI * 400.0;

fn window(seconds: f64, rate_hz: f64) -> Option<VelocitySettings> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    let window_samples = (seconds * rate_hz).round() as u32;
    Some(VelocitySettings::WindowDifference { window_samples })
}

/// The low-pass of OpenFFBoard with a quality of 0.55. Its cutoff is pre-warped.
fn biquad(cutoff_hz: f64, rate_hz: f64) -> Option<VelocitySettings> {
    let cutoff_hz = rate_hz / PI * (PI * cutoff_hz / rate_hz).tan();
    Some(VelocitySettings::SecondOrder { cutoff_hz, quality: 0.55 })
}

const OPENFFBOARD: &str = "OpenFFBoard, Axis.h, filterSpeedCst";
const ODRIVE: &str = "ODrive, Firmware/MotorControl/encoder.cpp, bandwidth";
const MOTEUS: &str = "moteus, fw/motor_position.h, pll_filter_hz";

pub const PEERS: [Peer; 13] = [
    Peer {
        name: "chai3d",
        does: "difference over 15 ms",
        source: "CHAI3D 3, CGenericHapticDevice.cpp, m_linearVelocityWindowSize",
        settings: |rate_hz| window(0.015, rate_hz),
    },
    Peer {
        name: "force-dimension",
        does: "difference over 20 ms",
        source: "Force Dimension SDK, dhdc.h, DHD_VELOCITY_WINDOW",
        settings: |rate_hz| window(0.020, rate_hz),
    },
    Peer {
        name: "simplefoc",
        does: "difference, one pole of 5 ms",
        source: "SimpleFOC, src/common/defaults.h, DEF_VEL_FILTER_Tf",
        settings: |rate_hz| poles([0.005 / (0.005 + 1.0 / rate_hz), 0.0], rate_hz),
    },
    Peer {
        name: "openffboard-40",
        does: "difference, low-pass of 40 Hz, Q 0.55",
        source: OPENFFBOARD,
        settings: |rate_hz| biquad(40.0, rate_hz),
    },
    Peer {
        name: "openffboard-70",
        does: "difference, low-pass of 70 Hz, Q 0.55",
        source: OPENFFBOARD,
        settings: |rate_hz| biquad(70.0, rate_hz),
    },
    Peer {
        name: "openffboard-120",
        does: "difference, low-pass of 120 Hz, Q 0.55",
        source: OPENFFBOARD,
        settings: |rate_hz| biquad(120.0, rate_hz),
    },
    Peer {
        name: "openffboard-180",
        does: "difference, low-pass of 180 Hz, Q 0.55",
        source: OPENFFBOARD,
        settings: |rate_hz| biquad(180.0, rate_hz),
    },
    Peer {
        name: "hapkit",
        does: "difference, two poles at 0.95 a sample",
        source: "Hapkit, template of the course's sketch, vh",
        settings: |rate_hz| poles([0.95; 2], rate_hz),
    },
    Peer {
        name: "odrive",
        does: "tracking loop of 1000 rad/s, explicit, its velocity a sample late",
        source: ODRIVE,
        settings: |rate_hz| tracking(1000.0, LATE, rate_hz),
    },
    Peer {
        name: "odrive-exact",
        does: "the same in ODrive's order: predicted first, not late",
        source: ODRIVE,
        settings: |rate_hz| predicting(1000.0, rate_hz),
    },
    Peer {
        name: "moteus",
        does: "tracking loop of 400 Hz, explicit, its bare integral a sample late",
        source: MOTEUS,
        settings: |rate_hz| tracking(MOTEUS_W, LATE, rate_hz),
    },
    Peer {
        name: "moteus-exact",
        does: "the same with the proportional part, as it leaves the firmware; until June 2025",
        source: MOTEUS,
        settings: |rate_hz| tracking(MOTEUS_W, 2.0 * rate_hz / MOTEUS_W, rate_hz),
    },
    Peer {
        name: "moteus-2025",
        does: "the same since June 2025: 400 Hz where the position is down by 3 dB, poles at 161 Hz",
        source: MOTEUS,
        settings: |rate_hz| tracking(MOTEUS_W / 2.48, 2.48 * 2.0 * rate_hz / MOTEUS_W, rate_hz),
    },
];

/// The loops in which the estimators are compared: the scene's own loop, and a loop with the latency and the output of
/// each board.
///
/// # Errors
/// The scene is not allowed with a board's output.
pub fn loops(scene: &NamedScene) -> Result<Vec<(String, Scene)>, Error> {
    let mut loops = vec![(scene.name.clone(), scene.scene.clone())];
    for of_board in boards(&scene.scene)? {
        if loops.iter().all(|(_, other)| *other != of_board.1) {
            loops.push(of_board);
        }
    }
    Ok(loops)
}

/// An estimator in one loop: one row of the table.
#[derive(Clone, Debug)]
pub struct Row {
    pub of_loop: usize,
    pub name: String,
    pub does: String,
    /// Source of the estimator. It is empty for the scene's own estimator.
    pub source: &'static str,
    /// The boundaries for each limit, in the order of [`PeerQuestion::limits`].
    pub boundaries: Vec<Boundaries>,
}

#[derive(Clone, Debug)]
pub struct PeerQuestion {
    /// Names and scenes of the loops: the scene's own loop, and loops with a board's output stage.
    pub loops: Vec<(String, Scene)>,
    /// Limits of a stable hit. A limit is for the RMS of the motion or for the sensation level.
    pub limits: Vec<Limit>,
    /// The scene's own estimator at several cutoffs.
    pub own: Vec<VelocitySettings>,
    pub walk: Walk,
    pub repeats: u32,
}

impl PeerQuestion {
    /// A question with these limits and these steps of K and B.
    ///
    /// # Errors
    /// The scene does not allow one of the limits.
    pub fn of(
        scene: &NamedScene,
        limits: &[LimitAsked],
        steps: Option<[f64; 2]>,
        repeats: u32,
        names: Names,
    ) -> Result<Self, Error> {
        let limits: Vec<Limit> = limits.iter().map(|limit| limit.of(&scene.scene)).collect();
        let walk = finer(&scene.scene, steps, None);
        check(&scene.scene, &limits, walk, names)?;
        let (velocity, design) = (scene.scene.velocity, scene.scene.design());
        let own = filters(&velocity, &OWN_HZ).into_iter();
        let own = own.filter(|filter| filter.build(&design).is_ok()).collect();
        Ok(Self { loops: loops(scene)?, limits, own, walk, repeats })
    }

    pub fn walks(&self) -> u64 {
        let rows = (PEERS.len() + self.own.len() + 1) * self.loops.len();
        (rows * self.limits.len()) as u64 * u64::from(self.repeats)
    }
}

#[derive(Clone, Debug)]
pub struct PeerStudy {
    pub question: PeerQuestion,
    /// Rows of the first loop, then of the next loop. Each loop has the peers, the scene's own estimator and the true
    /// velocity.
    pub rows: Vec<Row>,
    pub notes: Vec<String>,
}

impl PeerStudy {
    /// Mean area that a loop reaches at a limit if it gets the true velocity, in N^2 s/m^2.
    pub fn told_area(&self, of_loop: usize, limit: usize) -> Option<f64> {
        let told = self.rows.iter().find(|row| row.of_loop == of_loop && row.name == TOLD);
        told?.boundaries.get(limit).map(Boundaries::area)
    }
}

/// Name of the row for the true velocity.
pub const TOLD: &str = "true-velocity";

/// Walks every default, the scene's own estimator and the true velocity in all loops. Calls `done` after each walk.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn compare_peers(
    how: How<'_>,
    question: PeerQuestion,
    done: impl Fn() + Sync,
) -> Result<PeerStudy, Error> {
    let (mut jobs, mut notes) = (vec![], vec![]);
    for (of_loop, (_, scene)) in question.loops.iter().enumerate() {
        let row = |name, does, source| Row { of_loop, name, does, source, boundaries: vec![] };
        for peer in &PEERS {
            let settings =
                (peer.settings)(scene.control.rate_hz).ok_or("it is unstable".to_owned());
            let refused = |settings: &VelocitySettings| settings.build(&scene.design()).err();
            match settings
                .and_then(|own| refused(&own).map_or(Ok(own), |error| Err(error.to_string())))
            {
                Ok(velocity) => {
                    let row = row(peer.name.to_owned(), peer.does.to_owned(), peer.source);
                    jobs.push((row, with_filter(scene, &velocity), velocity));
                }
                Err(why) if of_loop == 0 => {
                    notes.push(format!("{}: not at this sample rate, {why}", peer.name));
                }
                Err(_) => {}
            }
        }
        for &velocity in &question.own {
            let name = match velocity.cutoff_hz() {
                Some(cutoff_hz) => format!("{}-{cutoff_hz}", scene.velocity.name()),
                None => scene.velocity.name().into(),
            };
            let does = describe(&velocity, scene.control.rate_hz);
            jobs.push((row(name, does, ""), scene.clone(), velocity));
        }
    }
    // The last job of each loop also walks the true velocity.
    let last = |at: usize| jobs.get(at + 1).is_none_or(|next| next.0.of_loop != jobs[at].0.of_loop);
    let ask = |at: usize| -> Result<Vec<LimitResult>, Error> {
        let (_, scene, velocity) = &jobs[at];
        let PeerQuestion { limits: asked, walk, repeats, .. } = &question;
        let question = Question {
            limits: asked.clone(),
            rms_of: RmsOf::Motion,
            filters: vec![*velocity],
            repeats: *repeats,
            walk: *walk,
            situations: vec![Situation { push: scene.wall_hit.push_by, arm: None }],
            told: last(at),
        };
        limits(How { numeric: Numeric::Fixed, ..how }, scene, &question, &done)
    };
    let asked: Vec<_> = (0..jobs.len()).into_par_iter().with_max_len(1).map(ask).collect();
    let mut rows = vec![];
    for (at, ((row, ..), results)) in jobs.iter().zip(asked).enumerate() {
        let results = results?;
        let of = |limit: &Limit| results.iter().find(|result| result.limit == *limit);
        let found: Vec<&LimitResult> = question.limits.iter().filter_map(of).collect();
        let estimated = |result: &&LimitResult| {
            let cutoff = result.result.cutoffs.first();
            cutoff.map(|cutoff| cutoff.boundaries.clone()).unwrap_or_default()
        };
        rows.push(Row { boundaries: found.iter().map(estimated).collect(), ..row.clone() });
        if last(at) {
            rows.push(Row {
                of_loop: row.of_loop,
                name: TOLD.into(),
                does: "no noise, quantisation or delay in the velocity; counts as they are".into(),
                source: "",
                boundaries: found.iter().map(|result| result.told.clone()).collect(),
            });
        }
    }
    Ok(PeerStudy { question, rows, notes })
}
