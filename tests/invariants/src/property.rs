//! A property, and the macro with which modules define their properties.

use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

#[derive(Clone, Copy, Debug)]
pub struct Property {
    /// The module and the name, in the form `module::name`.
    pub name: &'static str,
    /// The statement that must hold.
    pub states: &'static str,
    pub cases: u32,
    /// Tries the property. The error is the smallest failing case.
    pub(crate) run: fn(&mut TestRunner) -> Result<(), String>,
}

impl Property {
    /// Tries one batch. The cases depend only on seed, name and number.
    ///
    /// # Errors
    /// The failed statement and the smallest failing case.
    pub fn batch(&self, seed: u64, number: u64) -> Result<(), String> {
        let mut bytes = [0; 32];
        let name = self.name.bytes().fold(0xCBF2_9CE4_8422_2325u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3) // FNV-1a
        });
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip([seed, name, number, 0]) {
            *place = word.to_le_bytes();
        }
        let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &bytes);
        let config = Config {
            cases: self.cases,
            failure_persistence: None,
            max_shrink_time: 20_000,
            max_shrink_iters: 50_000,
            max_global_rejects: 100 * self.cases + 1000,
            ..Config::default()
        };
        (self.run)(&mut TestRunner::new_with_rng(config, rng))
    }
}

/// The properties of a module. Each property has a text, a name, the number of cases in a batch, a strategy, and the
/// check of a case. The check panics if the property does not hold.
#[macro_export]
macro_rules! properties {
    ($(
        $(#[doc = $states:literal])+
        $name:ident($cases:expr, $case:pat_param in $strategy:expr) $check:block
    )*) => {
        /// The properties of this module.
        pub const ALL: &[$crate::Property] = &[$($crate::Property {
            name: concat!(module_path!(), "::", stringify!($name)),
            states: concat!($($states),+),
            cases: $cases,
            run: |runner| {
                let outcome = runner.run(&$strategy, |$case| {
                    $check;
                    Ok(())
                });
                outcome.map_err(|error| error.to_string())
            },
        }),*];

        #[cfg(test)]
        mod sample {
            $(#[test]
            fn $name() {
                $crate::property::sample(super::ALL, stringify!($name));
            })*
        }
    };
}

/// The modules of the suite.
#[macro_export]
macro_rules! properties_of {
    ($($module:ident,)*) => {
        $(mod $module;)*

        pub fn all() -> impl Iterator<Item = &'static Property> {
            [$($module::ALL),*].into_iter().flatten()
        }
    };
}

/// Tries the batch that `cargo test` tries, always the same one.
#[cfg(test)]
pub fn sample(properties: &[Property], name: &str) {
    let property = properties.iter().find(|property| property.title().ends_with(name)).unwrap();
    if let Err(text) = property.batch(SAMPLE_SEED, 0) {
        panic!("{}", property.failure(&text, SAMPLE_SEED, 0));
    }
}

#[cfg(test)]
const SAMPLE_SEED: u64 = 1;

impl Property {
    /// The property's name without the package's name.
    pub fn title(&self) -> &'static str {
        self.name.split_once("::").map_or(self.name, |(_, title)| title)
    }

    /// The message for a failing case.
    pub fn failure(&self, text: &str, seed: u64, number: u64) -> String {
        format!(
            "{}: does not hold:{}\n{text}\nagain: cargo invariants --seed {seed} --only {} --batch {number}",
            self.title(),
            self.states,
            self.title(),
        )
    }
}
