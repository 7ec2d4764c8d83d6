//! Names of all combinations of format and form.

/// The number format of a filter, or the library that it comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Format {
    /// The core's format. It has 32-bit coefficients, 64-bit sums and error feedback.
    I32Feedback,
    /// The core's format without error feedback. It has 32-bit coefficients and 64-bit sums.
    I32,
    /// Q15 with error feedback. It has 16-bit words and 32-bit sums.
    Q15Feedback,
    /// Q15 without error feedback. It has 16-bit words and 32-bit sums.
    Q15,
    F32,
    F64,
    /// The filter of idsp with 32-bit words, 64-bit sums and first-order error feedback.
    IdspDither,
    /// The filter of idsp with 32-bit words. It keeps past outputs in 64 bits.
    IdspWide,
    /// The filter of CMSIS-DSP with 32-bit words and 64-bit sums. The sums are truncated.
    CmsisQ31,
    /// The filter of CMSIS-DSP with 32-bit words. It keeps past outputs in 64 bits, and truncates its sums.
    Cmsis32x64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Form {
    Direct1,
    Direct2Transposed,
    /// The state-variable form with trapezoidal integrators.
    StateVariable,
    Delta,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Variant {
    pub format: Format,
    pub form: Form,
}

impl Format {
    pub const fn name(self) -> &'static str {
        match self {
            Self::I32Feedback => "i32-feedback",
            Self::I32 => "i32",
            Self::Q15Feedback => "q15-feedback",
            Self::Q15 => "q15",
            Self::F32 => "f32",
            Self::F64 => "f64",
            Self::IdspDither => "idsp-dither",
            Self::IdspWide => "idsp-wide",
            Self::CmsisQ31 => "cmsis-q31",
            Self::Cmsis32x64 => "cmsis-32x64",
        }
    }
}

impl Form {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Direct1 => "direct-1",
            Self::Direct2Transposed => "direct-2t",
            Self::StateVariable => "state-variable",
            Self::Delta => "delta",
        }
    }
}

impl Variant {
    /// All variants. The first is the core. A variant's number is its index here.
    pub const ALL: [Self; 22] = {
        use Form::{Delta, Direct1, Direct2Transposed, StateVariable};
        use Format::{
            Cmsis32x64, CmsisQ31, F32, F64, I32, I32Feedback, IdspDither, IdspWide, Q15,
            Q15Feedback,
        };
        const fn of(format: Format, form: Form) -> Variant {
            Variant { format, form }
        }
        [
            of(I32Feedback, Direct1),
            of(I32, Direct1),
            of(I32, Direct2Transposed),
            of(I32, StateVariable),
            of(I32, Delta),
            of(Q15Feedback, Direct1),
            of(Q15, Direct1),
            of(Q15, Direct2Transposed),
            of(Q15, StateVariable),
            of(Q15, Delta),
            of(F32, Direct1),
            of(F32, Direct2Transposed),
            of(F32, StateVariable),
            of(F32, Delta),
            of(F64, Direct1),
            of(F64, Direct2Transposed),
            of(F64, StateVariable),
            of(F64, Delta),
            of(IdspDither, Direct1),
            of(IdspWide, Direct1),
            of(CmsisQ31, Direct1),
            of(Cmsis32x64, Direct1),
        ]
    };

    pub fn of_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }
}

impl core::fmt::Display for Variant {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}/{}", self.format.name(), self.form.name())
    }
}
