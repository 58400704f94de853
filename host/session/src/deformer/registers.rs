//! Registers of the processor, and their state after a call of a plugin.

/// Floating-point modes of this thread: rounding, and the treatment of numbers too small to be normal.
///
/// A plugin may change these modes for all that follows on the thread: on purpose, to round elsewhere, or as
/// a library that was built with `-ffast-math`, which does so when it is loaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Modes {
    #[cfg(target_arch = "x86_64")]
    vectors: u32,
    #[cfg(target_arch = "x86_64")]
    stack: u16,
    #[cfg(target_arch = "aarch64")]
    control: u64,
}

#[cfg(target_arch = "x86_64")]
impl Modes {
    /// Bits of MXCSR that tell what has happened; the others are the modes.
    const TOLD: u32 = 0x3f;

    /// The modes of this thread's registers.
    pub fn current() -> Self {
        let (mut vectors, mut stack) = (0_u32, 0_u16);
        // SAFETY: both write one number to the place that they are given, and change nothing else.
        unsafe {
            std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut vectors, options(nostack, preserves_flags));
            std::arch::asm!("fnstcw [{}]", in(reg) &raw mut stack, options(nostack, preserves_flags));
        }
        Self { vectors: vectors & !Self::TOLD, stack }
    }

    /// Sets the modes of this thread.
    pub fn set(self) {
        // SAFETY: both read one number, which `current` got from the same register: no reserved bit is set.
        // All code outside of plugins relies on the modes that are set here.
        unsafe {
            std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const self.vectors, options(nostack, preserves_flags, readonly));
            std::arch::asm!("fldcw [{}]", in(reg) &raw const self.stack, options(nostack, preserves_flags, readonly));
        }
    }
}

#[cfg(target_arch = "aarch64")]
impl Modes {
    /// The modes of this thread's registers.
    pub fn current() -> Self {
        let control: u64;
        // SAFETY: a register is read, and nothing is changed.
        unsafe {
            std::arch::asm!("mrs {}, fpcr", out(reg) control, options(nomem, nostack, preserves_flags))
        };
        Self { control }
    }

    /// Sets the modes of this thread.
    pub fn set(self) {
        // SAFETY: the value is one that `current` read from this register. All code outside of plugins relies
        // on it.
        unsafe {
            std::arch::asm!("msr fpcr, {}", in(reg) self.control, options(nomem, nostack, preserves_flags))
        };
    }
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
impl Modes {
    /// Modes without content: those of this processor are not known.
    pub fn current() -> Self {
        Self {}
    }

    /// Does nothing, as above.
    pub fn set(self) {}
}

/// Makes the upper halves of the vector registers zero, as each function that used them should have: where
/// one did not (kernels in assembly, say), all that follows on this thread without vectors that wide is
/// several times as slow: sine and exponential of the C library were, in one plugin after another one's
/// matrix products.
#[inline]
pub(super) fn clear_upper_halves() {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx") {
        #[target_feature(enable = "avx")]
        fn clear() {
            std::arch::x86_64::_mm256_zeroupper();
        }
        // SAFETY: the processor knows AVX. No function's own values are in upper halves across this call, as
        // the convention for calls keeps none there.
        unsafe { clear() }
    }
}
