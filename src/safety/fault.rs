//! The reasons for which the output is switched off. Each has a number that never changes. A set of reasons is a type
//! too.

use core::fmt;

macro_rules! faults {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $text:literal;)*) => {
        /// A reason to switch the output off. No code ever gets a new meaning.
        ///
        /// | group | about |
        /// |-------|-------|
        /// | 10..  | motion: a count that cannot be right, or a motion that must stop |
        /// | 20..  | time: something came late or not at all |
        /// | 30..  | power and people |
        /// | 40..  | program |
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u8)]
        pub enum Fault {
            $($(#[$doc])* $name = $code,)*
        }

        impl Fault {
            /// All faults, in the order of rising codes.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The fault with this code, if there is one.
            pub const fn from_code(code: u8) -> Option<Self> {
                match code {
                    $($code => Some(Self::$name),)*
                    _ => None,
                }
            }

            /// A short name for people.
            pub const fn text(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }
        }
    };
}

faults! {
    /// The count changed in one sample by more than the highest believable speed allows. Causes: a bad contact,
    /// interference, or a write to the counter. The zero is lost.
    CountJump = 10, "count jump";
    /// The handle is faster than allowed.
    OverSpeed = 11, "over-speed";
    /// The handle is more than 2^30 counts away from zero.
    OutOfRange = 12, "out of range";
    /// A force outside contact moved the handle too little. Causes: a dead encoder, a blocked handle, an amplifier
    /// without power.
    PushWithoutMotion = 13, "push without motion";
    /// The small force at `arm` moved the count the wrong way, or too little.
    SignTestFailed = 14, "sign test failed";
    /// The handle is outside the device's travel, while force is on.
    BeyondTravel = 15, "beyond travel";
    /// An output was not ready when the next output was due.
    LateRender = 20, "late render";
    /// For 10 ms no output was ready.
    StuckRender = 21, "stuck render";
    /// The watchdog reset the processor.
    WatchdogReset = 22, "watchdog reset";
    /// The processor was reset while force was on.
    ResetWhileArmed = 23, "reset while armed";
    /// The rate of the samples is wrong.
    SampleRate = 24, "sample rate";
    /// The emergency stop opened, or its wire broke, while force was on.
    EmergencyStop = 30, "emergency stop";
    /// The supply fell below the limit of the voltage detector.
    BrownOut = 31, "brown-out";
    /// A debugger halted the processor while force was on.
    Debugger = 32, "debugger halt";
    /// The crystal or clock input failed. The processor runs on its internal oscillator.
    ClockFailure = 33, "clock failure";
    /// While force was on, the host did not send the command `alive` within the time that it had stated.
    HostSilent = 34, "host silent";
    /// The voltage of the force output does not match its code.
    ForceOutput = 35, "force output";
    /// The motor's current does not match the force output.
    MotorCurrent = 36, "motor current";
    /// The settings in force are not valid, or they are outside the envelope while the envelope is locked.
    Settings = 40, "settings";
    /// The program stopped itself.
    Panic = 41, "panic";
    /// The processor found an instruction or address that it cannot handle.
    HardFault = 42, "hard fault";
    /// A register that decides about the force has another value than the program has set.
    Registers = 43, "registers";
    /// A number that decides about the force differs from the checked number.
    Memory = 44, "memory";
    /// An interrupt without a task came.
    Interrupt = 45, "unexpected interrupt";
    /// The program in flash, or the device record, has changed since the check at boot.
    Image = 46, "image";
}

impl Fault {
    /// The code in status, telemetry and fault memory. It is never 0.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// Whether counts may be missing, so that the encoder's zero is lost.
    pub const fn loses_zero(self) -> bool {
        FaultSet::EMPTY.with(self).loses_zero()
    }

    /// The fault's bit in a [`FaultSet`]. Each group of codes has a byte.
    const fn bit(self) -> u32 {
        let (group, member) = (self.code() / 10, self.code() % 10);
        1 << ((group as u32 * 8 + member as u32).wrapping_sub(8) & 31)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.code(), self.text())
    }
}

/// A set of faults. The fault with code 10 g + n is bit 8 (g - 1) + n. For example, codes 10 to 17 are bits 0 to 7, and
/// codes 20 to 27 are bits 8 to 15.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultSet(u32);

impl FaultSet {
    /// The set of no faults.
    pub const EMPTY: Self = Self(0);

    /// The set as bits.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Makes a set from its bits. Bits that no fault has are kept.
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// Whether the set has no fault.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether `fault` is in the set.
    pub const fn contains(self, fault: Fault) -> bool {
        self.0 & fault.bit() != 0
    }

    /// The set with `fault`.
    #[must_use]
    pub const fn with(self, fault: Fault) -> Self {
        Self(self.0 | fault.bit())
    }

    /// The set with `fault` if `present`.
    #[must_use]
    #[inline]
    pub const fn with_if(self, fault: Fault, present: bool) -> Self {
        if present { self.with(fault) } else { self }
    }

    /// All faults of both sets.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// All faults of `self` that are not in `other`.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// All faults that are in both sets.
    #[must_use]
    pub const fn within(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Whether a fault of the set loses the zero.
    pub const fn loses_zero(self) -> bool {
        self.0
            & (Fault::CountJump.bit()
                | Fault::OutOfRange.bit()
                | Fault::PushWithoutMotion.bit()
                | Fault::SignTestFailed.bit()
                | Fault::Memory.bit())
            != 0
    }

    /// The fault with the lowest code. A bit that no fault has is a flipped bit: [`Fault::Memory`].
    pub fn first(self) -> Option<Fault> {
        let bit = u8::try_from(self.0.trailing_zeros()).unwrap_or_default(); // at most 32
        let first = Fault::from_code((bit / 8 + 1) * 10 + bit % 8);
        first.or((self.0 != 0).then_some(Fault::Memory))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn codes_are_stable_and_come_back() {
        let codes: std::vec::Vec<u8> = Fault::ALL.iter().map(|f| f.code()).collect();
        assert_eq!(
            codes,
            [
                10, 11, 12, 13, 14, 15, 20, 21, 22, 23, 24, 30, 31, 32, 33, 34, 35, 36, 40, 41, 42,
                43, 44, 45, 46
            ]
        );
        for code in 0..=u8::MAX {
            let fault = Fault::from_code(code);
            assert_eq!(fault.is_some(), codes.contains(&code));
            assert!(fault.is_none_or(|f| f.code() == code));
        }
        assert!(codes.iter().all(|&code| code % 10 < 8 && (10..50).contains(&code)));
        assert_eq!(Fault::LateRender.to_string(), "20 (late render)");
    }

    #[test]
    fn a_set_that_is_not_empty_has_a_first_fault() {
        for bit in 0..u32::BITS {
            let first = FaultSet(1 << bit | 1 << 31).first();
            let own = Fault::ALL.iter().copied().find(|fault| fault.bit() == 1 << bit);
            assert_eq!(first, Some(own.unwrap_or(Fault::Memory)), "{bit}");
        }
        assert_eq!(FaultSet::EMPTY.first(), None);
    }

    #[test]
    fn five_faults_lose_the_zero_alone_or_among_others() {
        use Fault as F;
        let lose =
            [F::CountJump, F::OutOfRange, F::PushWithoutMotion, F::SignTestFailed, F::Memory];
        for &fault in Fault::ALL {
            assert_eq!(fault.loses_zero(), lose.contains(&fault), "{fault}");
            let among = FaultSet::EMPTY.with(fault).with(F::EmergencyStop);
            assert_eq!(among.loses_zero(), lose.contains(&fault), "{fault}");
        }
    }

    #[test]
    fn sets_keep_each_fault_apart() {
        for &a in Fault::ALL {
            let set = FaultSet::EMPTY.with(a);
            assert_eq!(set.first(), Some(a));
            for &b in Fault::ALL {
                assert_eq!(set.contains(b), a == b);
            }
            assert!(set.without(set).is_empty());
            assert_eq!((set.within(set), set.within(FaultSet::EMPTY)), (set, FaultSet::EMPTY));
            assert_eq!((set.with_if(a, false), set.with(a)), (set, set));
        }
    }
}
