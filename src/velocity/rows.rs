//! Turns the rows of the table into types, and into functions for all estimators.

/// Reads the table. A row begins with `NAME = ID, "text" { KEY: type = ("name", "unit", default), .. }`, which has the
/// estimator's parameters. Then follow the sense that the estimator needs, if any, and the code that builds its integer
/// form for a [`Design`]. A weighted sum of differences also has its exact weights.
///
/// Rows are in groups. `if` has the Cargo features with which a build has the group. The two paths tell the compiler
/// how likely an estimator of the group is, and whether it is inlined.
macro_rules! estimators {
    ($(if $on:meta, $likely:path, $step:path {
        forms { $(
            $(#[$form_doc:meta])*
            $form:ident($integer:ty) $(keeps $own:ident)? $(shares $shared:ident)?;
        )* }
        names { $(
            $(#[$doc:meta])*
            $name:ident = $id:literal, $text:literal {
                $(
                    $(#[$key_doc:meta])*
                    $key:ident: $number:ty = ($parameter:literal, $unit:literal, $default:literal),
                )*
            } $(needs $sense:ident)?
            => |$design:pat_param| $of:ident($build:expr) $(, weights $weights:expr)?;
        )* }
    })*) => {
        /// The name of an estimator. The envelope uses the same name.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum EstimatorName {
            $($($(#[$doc])* #[cfg($on)] $name,)*)*
        }

        /// Name of the estimator, and its parameters in SI units.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum VelocitySettings {
            $($($(#[$doc])* #[cfg($on)] $name { $($(#[$key_doc])* $key: $number,)* },)*)*
        }

        /// A velocity estimator in integer form. Made by [`VelocitySettings::build`].
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(
            feature = "estimators",
            expect(clippy::large_enum_variant, reason = "there is no allocator to box it with")
        )]
        pub enum Estimator {
            $($($(#[$form_doc])* #[cfg($on)] $form($integer),)*)*
        }

        /// Name of an integer form. The variants have the same numbers as those of [`Estimator`], so that a single load
        /// finds the name.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum Kind {
            $($(#[cfg($on)] $form,)*)*
        }

        /// Memory of all forms. Each form has its own field. So the compiler can keep the few words of the usual form
        /// in registers.
        #[derive(Clone, Copy, Debug)]
        pub(super) struct Memory {
            $($($(#[cfg($on)] $own: <$integer as Form>::State,)?)*)*
        }

        impl EstimatorName {
            /// All estimators of this build.
            pub const ALL: &[Self] = &[$($(#[cfg($on)] Self::$name,)*)*];

            /// The word that a person types.
            pub const fn text(self) -> &'static str {
                match self { $($(#[cfg($on)] Self::$name => $text,)*)* }
            }

            /// The number that stands for the estimator in saved settings. A number never gets a new meaning.
            pub const fn id(self) -> u32 {
                match self { $($(#[cfg($on)] Self::$name => $id,)*)* }
            }

            /// The sense that the estimator needs in addition to the position.
            pub fn sense(self) -> Option<Sense> {
                match self { $($(#[cfg($on)] Self::$name => None $(.or(Some(Sense::$sense)))?,)*)* }
            }

            /// Parameters of the estimator. The first parameter is the tuning, which trades speed for accuracy. Some
            /// estimators have further parameters.
            pub fn parameters(self) -> [Option<Parameter>; PARAMETERS] {
                match self {
                    $($(#[cfg($on)] Self::$name => Parameter::all(&[$(
                        Parameter { name: $parameter, unit: $unit, default: $default },
                    )*]),)*)*
                }
            }

            /// Keys of the parameters. A key is a name with its unit, as in scenes and in [`SettingsError`].
            pub const fn keys(self) -> &'static [&'static str] {
                match self { $($(#[cfg($on)] Self::$name => &[$(stringify!($key)),*],)*)* }
            }

            /// Returns the estimator and the parameters of these settings. A value is 0 if there is no parameter at its
            /// index.
            pub fn of(settings: &VelocitySettings) -> (Self, Numbers) {
                match *settings {
                    $($(#[cfg($on)] VelocitySettings::$name { $($key),* } => {
                        (Self::$name, super::parameter::numbers(&[$(Number::value($key)),*]))
                    })*)*
                }
            }

            /// Makes settings of this estimator with these parameters. [`VelocitySettings::build`] checks their ranges
            /// later.
            pub fn settings(self, numbers: Numbers) -> VelocitySettings {
                let mut numbers = numbers.into_iter();
                match self {
                    $($(#[cfg($on)] Self::$name => VelocitySettings::$name {
                        $($key: Number::of(numbers.next().unwrap_or_default()),)*
                    },)*)*
                }
            }
        }

        impl VelocitySettings {
            /// Builds the estimator's integer form for this device.
            ///
            /// # Errors
            /// Names the parameter that is out of range, and the range.
            pub fn build(&self, design: &Design) -> Result<Estimator, SettingsError> {
                Ok(match *self {
                    $($(#[cfg($on)] Self::$name { $($key),* } => {
                        let $design = design;
                        Estimator::$of($build)
                    })*)*
                })
            }

            /// Returns the exact weights of the last differences, newest first. Returns `None` if the estimator is not
            /// a sum of differences.
            ///
            /// # Errors
            /// Names the parameter that is out of range, and the range.
            #[allow(unused_variables, reason = "a parameter that is no weight's")]
            pub fn weights(&self, design: &Design) -> Result<Option<FirDesign>, SettingsError> {
                Ok(match *self {
                    $($(#[cfg($on)] Self::$name { $($key),* } => {
                        let $design = design;
                        None $(.or(Some($weights)))?
                    })*)*
                })
            }
        }

        impl Estimator {
            #[inline(always)] // a call would put senses that nobody reads into memory
            pub(super) fn step(
                &self,
                (memory, seal): (&mut Memory, &mut u32),
                difference: i32,
                senses: &Senses,
            ) -> Velocity {
                match self {
                    $($(#[cfg($on)] Self::$form(form) => {
                        $likely();
                        let state = &mut memory.$($own)? $($shared)?;
                        $step(form, (state, seal), difference, senses)
                    })*)*
                }
            }

            /// Does [`step`](Self::step) for several samples.
            #[inline]
            pub(super) fn step_all(
                &self,
                (memory, seal): (&mut Memory, &mut u32),
                readings: (&[i32], impl FnMut(i32) -> i32),
                senses: &[Senses],
                velocities: &mut [Velocity],
            ) {
                match self {
                    $($(#[cfg($on)] Self::$form(form) => {
                        let state = &mut memory.$($own)? $($shared)?;
                        steps(form, (state, seal), readings, senses, velocities);
                    })*)*
                }
            }

            #[inline]
            pub(super) const fn kind(&self) -> Kind {
                match self { $($(#[cfg($on)] Self::$form(_) => Kind::$form,)*)* }
            }
        }

        impl Memory {
            pub(super) const REST: Self = Self {
                $($($(#[cfg($on)] $own: <$integer as Form>::REST,)?)*)*
            };

            pub(super) fn put(&self, estimator: &Estimator, bytes: &mut Bytes<'_>) {
                match estimator {
                    $($(#[cfg($on)] Estimator::$form(form) => {
                        form.put(&self.$($own)? $($shared)?, bytes);
                    })*)*
                }
            }

            pub(super) fn take(estimator: &Estimator, rest: &mut &[u8]) -> Option<Self> {
                let mut memory = Self::REST;
                match estimator {
                    $($(#[cfg($on)] Estimator::$form(form) => {
                        memory.$($own)? $($shared)? = form.take(rest)?;
                    })*)*
                }
                Some(memory)
            }

            #[inline(always)]
            pub(super) fn sum(&self, estimator: &Estimator) -> u32 {
                match estimator {
                    $($(#[cfg($on)] Estimator::$form(_) => {
                        $likely();
                        self.$($own)? $($shared)?.sum()
                    })*)*
                }
            }

            /// Whether the part of this memory that the sum does not cover is unchanged.
            #[inline(always)]
            pub(super) fn is_whole(&self, estimator: &Estimator) -> bool {
                match estimator {
                    $($(#[cfg($on)] Estimator::$form(_) => {
                        $likely();
                        self.$($own)? $($shared)?.is_whole()
                    })*)*
                }
            }

            /// Starts `estimator` as if the handle had always moved at this velocity.
            pub(super) fn restart(&mut self, estimator: &Estimator, velocity: Velocity) {
                match estimator {
                    $($(#[cfg($on)] Estimator::$form(form) => {
                        self.$($own)? $($shared)? = form.at(velocity);
                    })*)*
                }
            }
        }
    };
}
pub(super) use estimators;
