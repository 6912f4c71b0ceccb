//! The loops over pixels on every instruction set, against the same by hand.

use crate::detection::dispatch::{Isa, Kernels};
use crate::detection::{evening, kernel};
use proptest::prelude::*;

proptest! {
    #[test]
    fn every_instruction_set_gives_the_same_bits(
        bytes in prop::collection::vec(any::<u8>(), 3 * 8 * 97),
        width in 33..97usize, threshold in any::<u8>(), clip in any::<u8>(),
    ) {
        let size = 8 * width;
        let (c, a, b) = (&bytes[..size], &bytes[size..2 * size], &bytes[2 * size..3 * size]);
        let run = |isa: Isa| {
            let kernels = Kernels::new(isa);
            let limits = vec![threshold; width.div_ceil(32)];
            let limits = kernel::Limits { tiles: &limits, lowest: &limits };
            let mut hits = [0];
            kernels.changed_tiles((c, a), (width, 1), limits, &mut hits);
            let tiles: Vec<bool> = (0..width.div_ceil(32)).map(|tile| hits[0] >> tile & 1 != 0).collect();
            assert_eq!(hits[0] >> tiles.len(), 0);
            let mut rows = [0; 8];
            kernels.tile_masks((c, a, b), (0, width, 32), threshold, &mut rows);
            let first: Vec<u64> = (0..8)
                .map(|y| y * width..y * width + 32)
                .map(|row| kernels.change_mask(&c[row.clone()], &a[row.clone()], &b[row], threshold))
                .collect();
            assert_eq!(first, rows);
            let masks: Vec<u64> = c.chunks(32).zip(a.chunks(32)).zip(b.chunks(32))
                .map(|((c, a), b)| kernels.change_mask(c, a, b, threshold)).collect();
            let window: Vec<(usize, usize)> = (0..8).map(|y| (y % 3, (width - 3).min(5 * y))).collect();
            let sums = kernels.window_sums((c, a, b), (0, width), &window, u32::from(clip));
            let mut sizes = vec![0; size];
            kernels.change_row(c, a, b, &mut sizes);
            let mut sums_by_hand = kernel::WindowSums::default();
            for (y, (first, length)) in window.iter().enumerate() {
                for x in *first..(first + length).min(kernel::WINDOW_MAX_PX) {
                    let weight = (8 * u64::from(sizes[y * width + x])).saturating_sub(u64::from(clip));
                    sums_by_hand.sum += weight;
                    sums_by_hand.count += u64::from(weight > 0);
                    let (x, y) = (x as u64, y as u64);
                    for (sum, by) in sums_by_hand.first.iter_mut().zip([x, y]) {
                        *sum += weight * by;
                    }
                    for (sum, by) in sums_by_hand.second.iter_mut().zip([x * x, x * y, y * y]) {
                        *sum += weight * by;
                    }
                }
            }
            assert_eq!(sums, sums_by_hand);
            for (begin, length) in [(0, 5), (width, width), (size - 7, 7)] {
                let run = &sizes[begin..begin + length];
                let by_hand = (run.iter().map(|v| u32::from(*v)).sum::<u32>(), *run.iter().max().unwrap());
                assert_eq!(kernels.change_of_run((c, a, b), begin, length), by_hand);
            }
            let (clips, mut sums) = ([clip, clip / 2], [[0; 3]; 2]);
            kernels.clipped_change_sums((c, a), 5 * width, &clips, &mut sums);
            let both = (sums, kernels.read_both(c, a));
            let by_hand = |from: usize, to: usize, clip: u8| -> [u32; 3] {
                let up = |(c, a): (&u8, &u8)| u32::from(c.saturating_sub(*a).min(kernel::STEP_CLIP));
                let any = |(c, a): (&u8, &u8)| u32::from(c.abs_diff(*a).min(clip));
                let pairs = || c[from..to].iter().zip(&a[from..to]);
                [pairs().map(any).sum(), pairs().map(up).sum(), pairs().map(|(c, a)| up((a, c))).sum()]
            };
            assert_eq!(sums, [by_hand(0, 5 * width, clip), by_hand(5 * width, size, clip / 2)]);
            let mut of_tiles = vec![[0; 2]; width.div_ceil(32)];
            c.chunks(width).zip(a.chunks(width)).for_each(|rows| kernels.add_tile_sums(rows, &mut of_tiles));
            let rows = || c.chunks(width).zip(a.chunks(width));
            for (tile, sums) in of_tiles.iter().enumerate() {
                let columns = 32 * tile..(32 * tile + 32).min(width);
                let sum = |row: &[u8]| row[columns.clone()].iter().map(|v| u32::from(*v)).sum::<u32>();
                let by_hand: [u32; 2] = [rows().map(|(c, _)| sum(c)).sum(), rows().map(|(_, a)| sum(a)).sum()];
                assert_eq!(*sums, by_hand);
            }
            let evening = evening::Evening { scale: 700 + 4 * u16::from(clip), offset: 41 - i16::from(clip) };
            let (evenings, mut even) = ([evening, evening::Evening::NONE], vec![0; width]);
            kernels.even_row(&c[..width], 40, &evenings, &mut even);
            for (i, (even, level)) in even.iter().zip(c).enumerate().take(80) {
                let evening::Evening { scale, offset } = evenings[i / 40];
                let level = f64::from(*level) * f64::from(scale) / 1024.0 + 0.5 * f64::from(offset);
                assert!((f64::from(*even) - level.clamp(0.0, 255.0)).abs() <= 0.5, "{level} gives {even}");
            }
            (tiles, masks, both, sizes)
        };
        let portable = run(Isa::Portable);
        let by_hand = (0..width.div_ceil(32)).map(|tile| {
            let columns = tile * 32..(tile * 32 + 32).min(width);
            columns.into_iter().any(|x| (0..8).any(|y| c[y * width + x].abs_diff(a[y * width + x]) > threshold))
        });
        prop_assert!(portable.0.iter().copied().eq(by_hand));
        for isa in Isa::available() {
            prop_assert_eq!(&run(*isa), &portable, "{:?}", isa);
        }
    }
}

#[test]
fn the_sum_of_a_long_row_of_the_largest_changes_fits() {
    for isa in Isa::available() {
        let (dark, bright) = (vec![0; 20_000], vec![255; 20_000]);
        let mut sums = [[0; 3]];
        Kernels::new(*isa).clipped_change_sums((&bright, &dark), 20_000, &[255], &mut sums);
        assert_eq!(sums, [[5_100_000, 80_000, 0]]);
    }
}

#[test]
fn wide_rows_have_segments_with_thresholds_of_their_own() {
    // Three whole segments and a piece; the second is more tolerant, tile 9 within it more than its neighbours.
    let width: usize = 3 * 256 + 40;
    let tiles = width.div_ceil(32);
    let thresholds: Vec<u8> = (0..tiles)
        .map(|t| {
            if t == 9 {
                90
            } else if t / 8 == 1 {
                50
            } else {
                20
            }
        })
        .collect();
    let lowest: Vec<u8> = thresholds
        .chunks(kernel::SEGMENT_TILES)
        .map(|t| *t.iter().min().unwrap())
        .collect();
    // Two bands of the same thresholds, the second cut short.
    let (tiles, lowest) = (
        [&thresholds[..], &thresholds].concat(),
        [&lowest[..], &lowest].concat(),
    );
    let limits = kernel::Limits {
        tiles: &tiles,
        lowest: &lowest,
    };
    let previous = vec![100; 13 * width];
    let mut current = previous.clone();
    for (x, y, change) in [
        (5, 0, 20),
        (40, 7, 21),
        (300, 3, 80),
        (330, 3, 60),
        (700, 0, 21),
        (width - 1, 7, 21),
        (40, 8, 20),
        (100, 8, 21),
        (290, 12, 91),
        (width - 1, 12, 21),
    ] {
        current[y * width + x] += change;
    }
    for isa in Isa::available() {
        let mut hits = [0; 2];
        Kernels::new(*isa).changed_tiles((&current, &previous), (width, 2), limits, &mut hits);
        let hit = hits.map(|word: u64| (0..64).filter(|tile| word >> tile & 1 != 0).collect::<Vec<_>>());
        assert_eq!(hit, [vec![1, 10, 21, 25], vec![3, 9, 25]], "{isa:?}");
        let mut none = [0; 2];
        Kernels::new(*isa).changed_tiles((&previous, &previous), (width, 2), limits, &mut none);
        assert_eq!(none, [0; 2]);
    }
}
