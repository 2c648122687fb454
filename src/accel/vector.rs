//! Eight numbers at a time: what the blocks of [`super::lanes`] are written over. No operation is fused or approximate, so
//! every implementation gives the same bits.

/// How many numbers go together.
pub const LANES: usize = 8;

/// Eight numbers in memory; also the implementation for every processor.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub struct Lane(pub [f32; LANES]);

/// Arithmetic on eight numbers.
pub trait Lanes: Copy {
    type Mask: LaneMask;
    fn splat(v: f32) -> Self;
    fn load(lane: &Lane) -> Self;
    fn store(self) -> Lane;
    fn add(self, o: Self) -> Self;
    fn sub(self, o: Self) -> Self;
    fn mul(self, o: Self) -> Self;
    fn div(self, o: Self) -> Self;
    fn neg(self) -> Self;
    fn sqrt(self) -> Self;
    /// The smaller one; `o` where either is no number.
    fn min(self, o: Self) -> Self;
    /// The larger one; `o` where either is no number.
    fn max(self, o: Self) -> Self;
    fn lt(self, o: Self) -> Self::Mask;
    fn le(self, o: Self) -> Self::Mask;
    fn ne(self, o: Self) -> Self::Mask;
    /// `yes` where the mask is set, else `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// The smallest of the eight, none of which may be NaN.
    fn least(self) -> f32;
    /// first, first + 1, …
    #[inline(always)]
    fn count_from(first: f32) -> Self {
        Self::splat(first).add(Self::load(&Lane([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])))
    }
}

/// A truth value in every lane.
pub trait LaneMask: Copy {
    fn and(self, o: Self) -> Self;
    /// Lane i as bit i.
    fn bits(self) -> u32;
}

impl Lane {
    #[inline(always)]
    fn map(self, o: Lane, f: impl Fn(f32, f32) -> f32) -> Lane {
        Lane(std::array::from_fn(|i| f(self.0[i], o.0[i])))
    }
    #[inline(always)]
    fn compare(self, o: Lane, f: impl Fn(f32, f32) -> bool) -> [bool; LANES] {
        std::array::from_fn(|i| f(self.0[i], o.0[i]))
    }
}

impl Lanes for Lane {
    type Mask = [bool; LANES];
    #[inline(always)]
    fn splat(v: f32) -> Self {
        Lane([v; LANES])
    }
    #[inline(always)]
    fn load(lane: &Lane) -> Self {
        *lane
    }
    #[inline(always)]
    fn store(self) -> Lane {
        self
    }
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        self.map(o, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        self.map(o, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        self.map(o, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        self.map(o, |a, b| a / b)
    }
    #[inline(always)]
    fn neg(self) -> Self {
        Lane(self.0.map(|a| -a))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Lane(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        self.map(o, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        self.map(o, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        self.compare(o, |a, b| a < b)
    }
    #[inline(always)]
    fn le(self, o: Self) -> Self::Mask {
        self.compare(o, |a, b| a <= b)
    }
    #[inline(always)]
    fn ne(self, o: Self) -> Self::Mask {
        self.compare(o, |a, b| a != b)
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        Lane(std::array::from_fn(|i| if mask[i] { yes.0[i] } else { no.0[i] }))
    }
    #[inline(always)]
    fn least(self) -> f32 {
        self.0.into_iter().fold(f32::INFINITY, f32::min)
    }
}

impl LaneMask for [bool; LANES] {
    #[inline(always)]
    fn and(self, o: Self) -> Self {
        std::array::from_fn(|i| self[i] & o[i])
    }
    #[inline(always)]
    fn bits(self) -> u32 {
        self.into_iter().enumerate().fold(0, |bits, (i, lane)| bits | u32::from(lane) << i)
    }
}

#[cfg(target_arch = "x86_64")]
pub use avx2::{Avx2, has_avx2};

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{Lane, LaneMask, Lanes};
    use std::arch::x86_64::*;

    /// Whether the processor has AVX2.
    #[inline(always)]
    pub fn has_avx2() -> bool {
        std::arch::is_x86_feature_detected!("avx2")
    }

    /// Eight numbers in a register. To be used only in functions with `target_feature(enable = "avx2")`, which run only
    /// where [`has_avx2`] holds: that is what makes every call below sound.
    #[derive(Clone, Copy)]
    pub struct Avx2(__m256);

    impl Lanes for Avx2 {
        type Mask = Avx2;
        #[inline(always)]
        fn splat(v: f32) -> Self {
            Avx2(unsafe { _mm256_set1_ps(v) })
        }
        #[inline(always)]
        fn load(lane: &Lane) -> Self {
            // A lane is 32 bytes, aligned to 32.
            Avx2(unsafe { _mm256_load_ps(lane.0.as_ptr()) })
        }
        #[inline(always)]
        fn store(self) -> Lane {
            let mut lane = Lane([0.0; 8]);
            unsafe { _mm256_store_ps(lane.0.as_mut_ptr(), self.0) };
            lane
        }
        #[inline(always)]
        fn add(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_add_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn sub(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_sub_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn mul(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_mul_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn div(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_div_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn neg(self) -> Self {
            Avx2(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            Avx2(unsafe { _mm256_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn min(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_min_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn max(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_max_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn lt(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, o.0) })
        }
        #[inline(always)]
        fn le(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, o.0) })
        }
        #[inline(always)]
        fn ne(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_cmp_ps::<_CMP_NEQ_UQ>(self.0, o.0) })
        }
        #[inline(always)]
        fn select(mask: Self, yes: Self, no: Self) -> Self {
            Avx2(unsafe { _mm256_blendv_ps(no.0, yes.0, mask.0) })
        }
        #[inline(always)]
        fn least(self) -> f32 {
            unsafe {
                let four = _mm_min_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
                let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_min_ss(two, _mm_movehdup_ps(two)))
            }
        }
    }

    impl LaneMask for Avx2 {
        #[inline(always)]
        fn and(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_and_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn bits(self) -> u32 {
            unsafe { _mm256_movemask_ps(self.0) as u32 }
        }
    }
}
