//! The firmware: the tasks, their times and the data that each task owns. There is no arithmetic here. The control core
//! is the library of this package. The hardware is in [`board`], and the work of the tasks is in [`task`].
//!
//! | task        | rate                   | priority | does                                           |
//! |-------------|------------------------|----------|------------------------------------------------|
//! | `sample`    | 10 kHz, TIM5           | 15       | counter, velocity, watch over `render`         |
//! | `render`    | every period-th sample | 14       | wall, force output, records for telemetry      |
//! | `brown_out` | the supply falls       | 14       | off                                            |
//! | `link`      | after each `render`    | 1        | commands in, replies and telemetry out         |
//! | `idle`      |                        | 0        | watchdog, image in flash; sleeps               |
//!
//! Nothing delays `sample`. It shares no resource, takes no lock, spawns no task and does not log. No task of lower
//! priority masks `sample` (docs/firmware.md).
#![cfg_attr(target_os = "none", no_std, no_main)]
#![deny(unsafe_code)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod sync;
#[cfg(target_os = "none")]
mod task;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!(
        "This is the firmware: `cargo flash` puts it on a board, `cargo board` runs it without one."
    );
}

#[cfg(target_os = "none")]
#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use super::{board, task};

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        sample: task::Sample,
        render: task::Render,
        link: task::Link,
        idle: task::Idle,
    }

    /// The reset has switched all outputs off, and they stay off here. The samples start with `idle`, when all tasks
    /// exist and interrupts are on.
    #[init(local = [queues: task::Queues = task::Queues::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = board::take(cx.device, cx.core);
        let (sample, render, link, idle) = task::make(board, cx.local.queues);
        (Shared {}, Local { sample, render, link, idle })
    }

    #[task(binds = TIM5, priority = 15, local = [sample])]
    fn sample(cx: sample::Context) {
        cx.local.sample.run();
    }

    #[task(binds = SPI3, priority = 14, local = [render])]
    fn render(cx: render::Context) {
        cx.local.render.run();
    }

    #[task(binds = PVD, priority = 14)]
    fn brown_out(_: brown_out::Context) {
        board::supply_has_dropped();
    }

    #[task(binds = SPI2, priority = 1, local = [link])]
    fn link(cx: link::Context) {
        cx.local.link.run();
    }

    #[idle(local = [idle])]
    fn idle(cx: idle::Context) -> ! {
        board::start();
        loop {
            cx.local.idle.run();
        }
    }
}
