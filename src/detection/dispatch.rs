//! Chooses the instruction set of the pixel loops at run time; the only file of the room with `unsafe`.
#![allow(unsafe_code)]

use super::evening::{self, Evening};
use super::extents::{self, Columns, Extent};
use super::fronts::{self, Piece};
use super::kernel::{self, Limits, WindowSums};
use super::lanes::{Look, PixelLanes, Sums};
use super::packing;
use crate::scene::PixelFormat;

/// An instruction set the kernels are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Isa {
    /// Whatever the target guarantees (SSE2 on x86-64).
    Portable,
    /// 32-byte vectors.
    Avx2,
    /// 64-byte vectors (F, BW, VL).
    Avx512,
}

impl Isa {
    /// The one to use: the widest. The scan waits for memory, and with fewer instructions the processor looks further ahead.
    pub fn detect() -> Self {
        Self::available().last().copied().unwrap_or(Self::Portable)
    }

    /// The one to unpack with: of 64-byte vectors what unpacks byte by byte measured twice as slow as of 32-byte ones.
    pub fn to_unpack() -> Self {
        if Self::available().contains(&Self::Avx2) {
            Self::Avx2
        } else {
            Self::Portable
        }
    }

    /// All this machine runs, narrowest first.
    pub fn available() -> &'static [Self] {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("bmi2")
            {
                return &[Self::Portable, Self::Avx2, Self::Avx512];
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
                return &[Self::Portable, Self::Avx2];
            }
        }
        &[Self::Portable]
    }
}

/// The kernels of one instruction set. Made only by [`Kernels::new`], which checks that the machine has it.
#[derive(Debug, Clone, Copy)]
pub struct Kernels {
    isa: Isa,
}

/// The top bits of sixteen bytes.
#[inline(always)]
pub fn top_bits(flags: &[u8; 16]) -> u16 {
    let value = u128::from_le_bytes(*flags);
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_mm_movemask_epi8, _mm_set_epi64x};
        // SAFETY: every x86-64 has SSE2.
        unsafe { _mm_movemask_epi8(_mm_set_epi64x((value >> 64) as i64, value as i64)) as u16 }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        let low = |eight: u64| kernel::low_bits(((eight >> 7) & 0x0101_0101_0101_0101).to_le_bytes()) as u16;
        low(value as u64) | low((value >> 64) as u64) << 8
    }
}

/// Asks for the memory at a place of an image ahead of its use; nothing where the image has no such place.
#[inline(always)]
pub fn fetch_ahead(image: &[u8], at: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(level) = image.get(at) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every x86-64 has SSE, and nothing is read.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(level).cast::<i8>()) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (image, at);
}

/// [`fetch_ahead`] into the second cache: rows of a wide image two apart share a set of the first, which has no room for
/// those of three images.
#[inline(always)]
pub fn fetch_further(image: &[u8], at: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(level) = image.get(at) {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        // SAFETY: every x86-64 has SSE, and nothing is read.
        unsafe { _mm_prefetch::<_MM_HINT_T1>(std::ptr::from_ref(level).cast::<i8>()) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (image, at);
}

macro_rules! dispatched {
    ($room:ident: $(#[$doc:meta])* $name:ident ( $($arg:ident : $type:ty),* ) $(-> $result:ty)?) => {
        impl Kernels {
            $(#[$doc])*
            #[allow(clippy::too_many_arguments, reason = "self only says which instruction set")]
            #[inline]
            pub fn $name(self, $($arg: $type),*) $(-> $result)? {
                #[cfg(target_arch = "x86_64")]
                {
                    #[target_feature(enable = "avx2,bmi2")]
                    fn avx2($($arg: $type),*) $(-> $result)? {
                        $room::$name($($arg),*)
                    }
                    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx2,bmi2")]
                    fn avx512($($arg: $type),*) $(-> $result)? {
                        $room::$name($($arg),*)
                    }
                    match self.isa {
                        Isa::Portable => {}
                        // SAFETY: `new` keeps an instruction set only when `available` found it on this machine.
                        Isa::Avx2 => return unsafe { avx2($($arg),*) },
                        // SAFETY: as above.
                        Isa::Avx512 => return unsafe { avx512($($arg),*) },
                    }
                }
                $room::$name($($arg),*)
            }
        }
    };
}

impl Kernels {
    /// The kernels of `isa`, or portable ones where this machine lacks it.
    pub fn new(isa: Isa) -> Self {
        if Isa::available().contains(&isa) {
            Self { isa }
        } else {
            Self { isa: Isa::Portable }
        }
    }
}

dispatched!(
    kernel:
    /// See [`kernel::changed_tiles`].
    changed_tiles(images: (&[u8], &[u8]), size: (usize, usize), limits: Limits<'_>, hits: &mut [u64])
);
dispatched!(
    kernel:
    /// See [`kernel::clipped_change_sums`].
    clipped_change_sums(rows: (&[u8], &[u8]), length: usize, clips: &[u8], sums: &mut [[u32; 3]])
);
dispatched!(
    evening:
    /// See [`evening::add_tile_sums`].
    add_tile_sums(rows: (&[u8], &[u8]), sums: &mut [[u32; 2]])
);
dispatched!(
    evening:
    /// See [`evening::even_row`].
    even_row(row: &[u8], length: usize, evenings: &[Evening], even: &mut [u8])
);
dispatched!(
    kernel:
    /// See [`kernel::read_both`].
    read_both(one: &[u8], other: &[u8]) -> u8
);
dispatched!(
    kernel:
    /// See [`kernel::change_mask`].
    change_mask(current: &[u8], before: &[u8], after: &[u8], threshold: u8) -> u64
);
dispatched!(
    kernel:
    /// See [`kernel::tile_masks`].
    tile_masks(images: (&[u8], &[u8], &[u8]), place: (usize, usize, usize), threshold: u8, masks: &mut [u64]) -> bool
);
dispatched!(
    kernel:
    /// See [`kernel::window_sums`].
    window_sums(images: (&[u8], &[u8], &[u8]), place: (usize, usize), rows: &[(usize, usize)], floor: u32) -> WindowSums
);
dispatched!(
    kernel:
    /// See [`kernel::change_row`].
    change_row(current: &[u8], one: &[u8], other: &[u8], sizes: &mut [u8])
);
dispatched!(
    kernel:
    /// See [`kernel::change_of_run`].
    change_of_run(images: (&[u8], &[u8], &[u8]), begin: usize, length: usize) -> (u32, u8)
);
dispatched!(
    kernel:
    /// See [`kernel::linearise`].
    linearise(pixels: &PixelLanes, look: &Look<'_>) -> Sums
);
dispatched!(
    kernel:
    /// See [`kernel::locate`].
    locate(pixels: &PixelLanes, look: &Look<'_>) -> Sums
);
dispatched!(
    packing:
    /// See [`packing::unpack`].
    unpack(format: PixelFormat, packed: &[u8], levels: &mut [u8])
);
dispatched!(
    fronts:
    /// See [`fronts::rows_in_front`].
    rows_in_front(images: (&[u8], &[u8], &[u8]), size: (usize, usize), tile: (usize, usize), limits: (usize, u8)) -> u8
);
dispatched!(
    fronts:
    /// See [`fronts::row_in_front`].
    row_in_front(
        images: (&[u8], &[u8], &[u8]), size: (usize, usize), place: (usize, usize), limits: (usize, u8), changes: &mut Piece
    ) -> bool
);
dispatched!(
    extents:
    /// See [`extents::first_beside`].
    first_beside(all: Columns<'_>, of: Extent) -> Option<usize>
);
