//! Selects the implementation of the controller, its vector instructions, and the scenes that run in lanes.

use super::{
    estimator::Form,
    fixed::fixed_loop,
    float::FloatLoop,
    lanes::LaneController,
    scheduler,
    simd_ops::SimdOps,
    work::{Depth, Pushes, Tally, Task, Work, one_by_one},
};
use crate::{
    plant::AnyPlant,
    simulation::{
        prepared::{Numeric, PreparedScene},
        twin::Rounding,
    },
};

/// Implementation of the controller's arithmetic. Both implementations give the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// The core runs the hits one after another.
    Core,
    /// Vector lanes run the hits side by side, with the core's arithmetic written again for them. Scenes that cannot
    /// run in lanes run in the core itself.
    Lanes(Backend),
}

impl Engine {
    /// Lanes with the best vector instructions that this machine has.
    pub fn lanes() -> Self {
        Self::Lanes(Backend::best())
    }

    /// Name in reports and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Core => "core",
            Self::Lanes(_) => "lanes",
        }
    }

    /// Number of hits of this scene that run side by side in one thread. The number is 1 if the scene runs in the core.
    pub fn hits_at_once(self, prepared: &PreparedScene, numeric: Numeric) -> usize {
        match self {
            Self::Lanes(backend) if lanes_for(prepared, numeric) => backend.lanes(),
            _ => 1,
        }
    }
}

/// The vector instructions that lanes use. All backends give the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// 8 lanes in a vector.
    Avx512,
    /// 4 lanes in a vector.
    Avx2,
    /// 2 lanes in a vector.
    Neon,
    /// Scalar numbers instead of vectors. Several numbers run side by side, each in its own lane. Every machine has
    /// this backend.
    Plain,
}

impl Backend {
    /// All backends, the best first.
    pub const ALL: [Self; 4] = [Self::Avx512, Self::Avx2, Self::Neon, Self::Plain];

    pub fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "avx-512",
            Self::Avx2 => "avx2",
            Self::Neon => "neon",
            Self::Plain => "plain",
        }
    }

    /// Whether this machine has the instructions of this backend.
    pub fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => pulp::x86::V4::try_new().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => pulp::x86::V3::try_new().is_some(),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => pulp::aarch64::Neon::try_new().is_some(),
            Self::Plain => true,
            _ => false,
        }
    }

    pub fn best() -> Self {
        let found = Self::ALL.into_iter().find(|backend| backend.is_available());
        found.unwrap_or(Self::Plain)
    }

    /// Number of hits that run side by side in one thread.
    pub fn lanes(self) -> usize {
        match self {
            Self::Avx512 => 8 * VECTORS,
            Self::Avx2 => 4 * VECTORS,
            Self::Neon => 2 * VECTORS,
            Self::Plain => VECTORS,
        }
    }
}

/// Number of vectors that run side by side. While one vector waits for the result of its last sample, the processor
/// works on the second vector. Four vectors need more registers than the processor has. With four vectors, AVX-512
/// takes twice the time.
const VECTORS: usize = 2;

/// Whether the hits of a scene run in lanes. The plant must be linear, the encoder must have no errors, and the
/// estimator must have lanes in this arithmetic.
pub fn lanes_for(prepared: &PreparedScene, numeric: Numeric) -> bool {
    form_for(prepared, numeric).is_some()
}

fn form_for(prepared: &PreparedScene, numeric: Numeric) -> Option<Form> {
    let linear = !matches!(prepared.parts().plant, AnyPlant::Other(_));
    let estimator = prepared.scene().velocity.estimator();
    let form = Form::of(estimator)?;
    let stated = numeric == Numeric::Fixed || form == Form::LowPass;
    let told = matches!(form, Form::Observer | Form::Fusion);
    let seen = told || estimator.sense().is_none();
    let scene = prepared.scene();
    let plain = scene.passivity.is_none() && !scene.wall_hit.protocol.varies();
    (linear && stated && seen && plain).then_some(form)
}

pub fn run(
    engine: Engine,
    prepared: &PreparedScene,
    numeric: Numeric,
    depth: Depth,
    work: &mut dyn Work,
) -> Tally {
    let work = &mut Pushes::new(prepared, work);
    let numeric = if prepared.is_told() { Numeric::Fixed } else { numeric };
    let task = Task { prepared, numeric, depth };
    let Engine::Lanes(backend) = engine else { return one_by_one(task, work) };
    let Some(form) = form_for(prepared, numeric) else { return one_by_one(task, work) };
    match backend {
        #[cfg(target_arch = "x86_64")]
        Backend::Avx512 => match pulp::x86::V4::try_new() {
            Some(simd) => each_numeric::<_, VECTORS>(simd, task, form, work),
            None => one_by_one(task, work),
        },
        #[cfg(target_arch = "x86_64")]
        Backend::Avx2 => match pulp::x86::V3::try_new() {
            Some(simd) => each_numeric::<_, VECTORS>(simd, task, form, work),
            None => one_by_one(task, work),
        },
        #[cfg(target_arch = "aarch64")]
        Backend::Neon => match pulp::aarch64::Neon::try_new() {
            Some(simd) => each_numeric::<_, VECTORS>(simd, task, form, work),
            None => one_by_one(task, work),
        },
        Backend::Plain => each_numeric::<_, VECTORS>(pulp::Scalar, task, form, work),
        _ => one_by_one(task, work),
    }
}

fn each_numeric<'a, S: SimdOps, const R: usize>(
    simd: S,
    task: Task<'a>,
    form: Form,
    work: &mut Pushes<'a>,
) -> Tally {
    let float = |rounding| Box::new(FloatLoop::<S, R>::new(simd, rounding));
    let mut controller: Box<dyn LaneController<S, R>> = match task.numeric {
        Numeric::Fixed => fixed_loop(form, simd),
        Numeric::F64 => float(Rounding::Exact),
        Numeric::F64Rounded => float(Rounding::VelocityLsb),
    };
    each_plant(simd, task, &mut *controller, work)
}

/// Plants of four and six states run as plants of five and seven states, so that fewer variants are compiled.
fn each_plant<'a, S: SimdOps, const R: usize>(
    simd: S,
    task: Task<'a>,
    controller: &mut dyn LaneController<S, R>,
    work: &mut Pushes<'a>,
) -> Tally {
    use scheduler::run;
    match &task.prepared.parts().plant {
        AnyPlant::Plain(step) => run(simd, task, step, controller, work),
        AnyPlant::Three(step) => run(simd, task, step, controller, work),
        AnyPlant::Four(step) => run(simd, task, &step.padded::<5>(), controller, work),
        AnyPlant::Five(step) => run(simd, task, step, controller, work),
        AnyPlant::Six(step) => run(simd, task, &step.padded::<7>(), controller, work),
        AnyPlant::Seven(step) => run(simd, task, step, controller, work),
        _ => one_by_one(task, work),
    }
}
