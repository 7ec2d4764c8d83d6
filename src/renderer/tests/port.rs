//! Compares the energy account of the port with sums over the reported values.

use super::*;
use crate::safety::SafetySettings;

impl Bench {
    fn in_front_of_a_wall(&mut self, stiffness_n_per_m: f64) {
        self.stored.settings.wall.position_m = 0.002;
        (self.stored.push_n, self.stored.settle_s) = (2.835, 0.3);
        self.gains(stiffness_n_per_m, 0.0);
        self.run(50);
    }

    /// Runs a hit on a wall of this stiffness, with the handle at given positions at the outputs. Returns the two
    /// energies of the account.
    fn exchanged(mut self, stiffness_n_per_m: f64) -> (i64, i64) {
        self.in_front_of_a_wall(stiffness_n_per_m);
        self.met(self.hit());
        let first = self.reports.len();
        let (mut wall, mut touched, mut at) = (0i64, false, None);
        let (mut energy, mut given) = (0i64, 0i64);
        for _ in 0..5000 {
            self.output(None);
            let report = *self.reports.last().unwrap();
            let Record { position, force, flags, .. } = report.record;
            if let Some(at) = at {
                energy += wall * i64::from(position.wrapping_since(at));
                given = given.max(-energy);
            }
            let contact = flags.contains(Flags::CONTACT);
            if contact && !touched {
                energy = 0;
            }
            wall = i64::from(report.push.bits()) - i64::from(force.bits());
            (touched, at) = (contact, Some(position));
            if report.port.energy != 0 || contact {
                assert_eq!(report.port.energy, energy, "{}", self.reports.len() - first);
            }
            match report.event {
                Event::None => {}
                Event::HitOver(..) => {
                    assert_eq!(report.port.given, given);
                    return (energy, given);
                }
                other => panic!("{other:?}"),
            }
        }
        panic!("the hit does not end");
    }
}

#[test]
fn the_account_is_that_of_what_is_reported() {
    let (taken, given) = Bench::armed().exchanged(4000.0);
    assert!(
        taken != 0 && given > 0,
        "a spring alone gives back more than it took: {taken} {given}"
    );
}

#[test]
fn with_the_controller_a_contact_gives_at_most_the_reserve() {
    let (_, plain) = Bench::armed().exchanged(40_000.0);
    let safety = SafetySettings { passive_acceleration_m_per_s2: 60.0, ..DEVICE.safety };
    let plan = safety.build(&DEVICE.design).unwrap();
    let bench = Bench::with(plan).on();
    let reserve = plan.passivity().unwrap().reserve();
    let (_, given) = bench.exchanged(40_000.0);
    assert!(plain > reserve && given <= reserve, "{plain} {given} {reserve}");
}

/// The command `zero` renames the position. This is no motion. With the force off the account does not change.
#[test]
fn a_zero_and_an_end_of_the_force_book_nothing() {
    let mut bench = Bench::armed();
    bench.in_front_of_a_wall(4000.0);
    bench.met(Order::Request(Request::Zero));
    bench.run(3);
    assert_eq!(bench.reports.last().unwrap().port, Default::default());
    bench.met(bench.hit());
    let touches = (0..2000).any(|_| {
        bench.run(1);
        bench.reports.last().unwrap().port.energy != 0
    });
    assert!(touches);
    bench.run(2);
    bench.met(Order::Request(Request::Disarm));
    bench.run(1);
    let port = bench.reports.last().unwrap().port;
    bench.run(200);
    assert_eq!(bench.reports.last().unwrap().port, port);
}
