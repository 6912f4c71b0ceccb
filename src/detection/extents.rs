//! The extents of many blobs side by side, to find those next to each other.

/// Blobs this near become one, if the result is no larger than this.
const JOIN_GAP_PX: u32 = 2;
const JOINED_SIDE_PX: u32 = 26;
/// Blobs that are asked at a time.
const LANES: usize = 16;

/// First and last column, first and last row.
pub type Extent = [u32; 4];
/// Those of many, each of the four by itself.
pub type Columns<'a> = [&'a [u32]; 4];

/// The extents of blobs by their first rows, rising.
#[derive(Default)]
pub struct Extents([Vec<u32>; 4]);

impl Extents {
    /// Forgets all.
    pub fn clear(&mut self) {
        self.0.iter_mut().for_each(Vec::clear);
    }

    /// Adds a blob's.
    pub fn push(&mut self, extent: Extent) {
        for (all, place) in self.0.iter_mut().zip(extent) {
            all.push(place);
        }
    }

    /// Makes a blob near to no other.
    pub fn take_out(&mut self, index: usize) {
        let [left, ..] = &mut self.0;
        if let Some(left) = left.get_mut(index) {
            *left = u32::MAX;
        }
    }

    /// Those from an index on.
    pub fn from(&self, index: usize) -> Columns<'_> {
        self.0.each_ref().map(|all| all.get(index..).unwrap_or_default())
    }
}

/// Nothing where two extents are next to each other and small enough together.
#[inline(always)]
fn apart([left, right, top, bottom]: Extent, [o_left, o_right, o_top, o_bottom]: Extent) -> u32 {
    let by_columns = o_left.saturating_sub(right + JOIN_GAP_PX) | left.saturating_sub(o_right + JOIN_GAP_PX);
    let by_rows = o_top.saturating_sub(bottom + JOIN_GAP_PX) | top.saturating_sub(o_bottom + JOIN_GAP_PX);
    let width = right.max(o_right) - left.min(o_left);
    let height = bottom.max(o_bottom) - top.min(o_top);
    let too_large = width.saturating_sub(JOINED_SIDE_PX - 1) | height.saturating_sub(JOINED_SIDE_PX - 1);
    by_columns | by_rows | too_large
}

/// The first of the blobs that is next to one, and with it no larger than two are joined to.
#[inline(always)]
pub fn first_beside([lefts, rights, tops, bottoms]: Columns<'_>, of: Extent) -> Option<usize> {
    let ((l_whole, l_rest), (r_whole, r_rest)) = (lefts.as_chunks::<LANES>(), rights.as_chunks::<LANES>());
    let ((t_whole, t_rest), (b_whole, b_rest)) = (tops.as_chunks::<LANES>(), bottoms.as_chunks::<LANES>());
    let chunks = l_whole.iter().zip(r_whole).zip(t_whole.iter().zip(b_whole));
    for (chunk, ((l, r), (t, b))) in chunks.enumerate() {
        // Rows rise: all others begin further below.
        if t[0] > of[3] + JOIN_GAP_PX {
            return None;
        }
        let mut off = [0; LANES];
        for i in 0..LANES {
            off[i] = apart(of, [l[i], r[i], t[i], b[i]]);
        }
        let any = off.iter().fold(false, |any, off| any | (*off == 0));
        if any {
            return off.iter().position(|off| *off == 0).map(|i| LANES * chunk + i);
        }
    }
    let rest = l_rest.iter().zip(r_rest).zip(t_rest.iter().zip(b_rest));
    let mut rest = rest.map(|((l, r), (t, b))| apart(of, [*l, *r, *t, *b]));
    let found = rest.position(|off| off == 0)?;
    Some(LANES * l_whole.len() + found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::dispatch::{Isa, Kernels};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_first_beside_is_the_first_by_hand(
            blobs in prop::collection::vec((0..90u32, 0..12u32, 0..90u32, 0..12u32, any::<bool>()), 0..70),
            of in (0..90u32, 0..12u32, 0..40u32, 0..12u32),
        ) {
            let extent = |(x, w, y, h): (u32, u32, u32, u32)| [x, x + w, y, y + h];
            let mut blobs: Vec<(Extent, bool)> =
                blobs.into_iter().map(|(x, w, y, h, taken)| (extent((x, w, y, h)), taken)).collect();
            blobs.sort_by_key(|(extent, _)| extent[2]);
            let of = extent(of);
            let mut extents = Extents::default();
            for (index, (extent, taken)) in blobs.iter().enumerate() {
                extents.push(*extent);
                if *taken {
                    extents.take_out(index);
                }
            }
            let by_hand = blobs.iter().position(|(other, taken)| {
                let near = |one: &[u32], other: &[u32]| one[0] <= other[1] + 2 && other[0] <= one[1] + 2;
                let small = |one: &[u32], other: &[u32]| one[1].max(other[1]) - one[0].min(other[0]) < 26;
                let (x, y) = ((&of[..2], &other[..2]), (&of[2..], &other[2..]));
                !taken && near(x.0, x.1) && near(y.0, y.1) && small(x.0, x.1) && small(y.0, y.1)
            });
            for isa in Isa::available() {
                let found = Kernels::new(*isa).first_beside(extents.from(0), of);
                prop_assert_eq!(found, by_hand, "{:?}", isa);
            }
        }
    }
}
