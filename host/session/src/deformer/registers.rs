//! What a plugin leaves in the processor's registers.

/// Makes the upper halves of the vector registers zero, as each function that used them should have: where one did not (kernels
/// in assembly, say), all that follows on this thread without vectors that wide is several times as slow: sine and exponential
/// of the C library were, in one plugin after another one's matrix products.
#[inline]
pub fn clear_upper_halves() {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx") {
        #[target_feature(enable = "avx")]
        fn clear() {
            std::arch::x86_64::_mm256_zeroupper();
        }
        // SAFETY: the processor knows AVX. No function's own values are in upper halves across this call, as the convention for
        // calls keeps none there.
        unsafe { clear() }
    }
}
