//! Compares `explain` with `compare`. The three best changes of `explain` must be in the order that full searches give.

use std::sync::atomic::AtomicBool;

use host_sim::{
    analysis::{
        compare::{
            Entry,
            search::{Budget, tune},
            settings_of,
        },
        explain::explain,
    },
    engine::Engine,
    scene::NamedScene,
};

#[test]
#[ignore = "minutes; .ci/long runs it"]
fn the_best_changes_stand_in_the_order_of_full_searches() {
    let stop = AtomicBool::new(false);
    let engine = Engine::lanes();
    for name in ["paper-1um", "paper-2um"] {
        let scene = NamedScene::load(name).unwrap().scene;
        let quick = Budget { tunings: 8, repeats: 4 };
        let found = explain(engine, (&scene, None), None, quick, &stop, |_| ()).unwrap();
        // The default budget of `compare`.
        let full = Budget { tunings: 24, repeats: 4 };
        let areas: Vec<f64> = found.changes[..3]
            .iter()
            .map(|one| {
                let change = &one.change;
                let start = settings_of(Entry::Tuned(one.settings.name()), &change.scene);
                let (_, tuned) =
                    tune(engine, &change.scene, &start, true, full, &stop, &|_| ()).unwrap();
                let (quick, full) = (one.area()[0], tuned.boundaries.area());
                println!("{name}: {} {quick:.4e}, searched in full {full:.4e}", change.name);
                assert!(quick > 0.9 * full, "{}: {quick} of {full}", change.name);
                full
            })
            .collect();
        for pair in areas.windows(2) {
            assert!(pair[0] > 0.98 * pair[1], "{name}: {areas:?}");
        }
    }
}
