//! Scalar products of many short vectors of bytes, and the best of every row and column.
//!
//! Descriptors are bytes of such a length that a scalar product fits sixteen bits (see [`crate::features::rootsift`]),
//! so one instruction of AVX2 multiplies and adds 32 of them, one of NEON eight. The results are integers: the same on
//! every processor.

#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
use pulp::bytemuck;

use crate::features::rootsift::DESCRIPTOR_LEN;

/// Number of vectors in a block.
const LANES: usize = 16;
/// Number of vectors that are compared with the blocks together.
const QUERIES: usize = 4;
/// Number of blocks that are compared at a time.
const BLOCKS: usize = 2;

type Block = [[u8; 2 * LANES]; DESCRIPTOR_LEN / 2];
type Products = [[i16; LANES]; QUERIES];

/// The best and second best product, and the index of the best.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Best {
    pub(super) index: u32,
    pub(super) first: i16,
    pub(super) second: i16,
}

impl Best {
    /// Takes a product into account.
    pub(super) fn offer(&mut self, product: i16, index: u32) {
        if product > self.first {
            *self = Self { index, first: product, second: self.first };
        } else {
            self.second = self.second.max(product);
        }
    }
}

/// [`Best`] of sixteen vectors at once; `index` counts blocks or queries.
#[derive(Clone, Copy)]
struct BestLanes {
    first: [i16; LANES],
    second: [i16; LANES],
    index: [u16; LANES],
}

impl BestLanes {
    const NONE: Self = Self { first: [-1; LANES], second: [-1; LANES], index: [u16::MAX; LANES] };

    #[inline(always)]
    fn offer(&mut self, products: &[i16; LANES], index: u16) {
        for l in 0..LANES {
            let (value, first) = (products[l], self.first[l]);
            self.second[l] = self.second[l].max(value.min(first));
            self.index[l] = if value > first { index } else { self.index[l] };
            self.first[l] = first.max(value);
        }
    }

    /// The best over all lanes, of which lane `l` represents vector `16 index + l`.
    fn merged(&self) -> Best {
        let place = |l: usize| u32::from(self.index[l]) * LANES as u32 + l as u32;
        let mut top = 0;
        for l in 1..LANES {
            let (a, b) = (self.first[l], self.first[top]);
            if a > b || a == b && place(l) < place(top) {
                top = l;
            }
        }
        let others = (0..LANES).filter(|&l| l != top).map(|l| self.first[l]);
        let second = others.fold(self.second[top], i16::max);
        Best { index: place(top), first: self.first[top], second }
    }
}

/// Best column of every row and best row of every column, of the products of two lists of descriptors.
pub(super) fn best(rows: &[u8], columns: &[u8]) -> (Vec<Best>, Vec<Best>) {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        return simd.vectorize(|| best_with(rows, columns, |queries, block| wide_products(simd, queries, block)));
    }
    #[cfg(target_arch = "aarch64")]
    if let Some(simd) = pulp::aarch64::Neon::try_new() {
        return simd.vectorize(|| best_with(rows, columns, |queries, block| neon_products(simd, queries, block)));
    }
    best_with(rows, columns, plain_products)
}

#[inline(always)]
fn best_with(
    rows: &[u8],
    columns: &[u8],
    products: impl Fn(&[&[u8; DESCRIPTOR_LEN]; QUERIES], &[Block; BLOCKS]) -> [Products; BLOCKS],
) -> (Vec<Best>, Vec<Best>) {
    // In place of a missing query; its products are ignored.
    const ZERO: [u8; DESCRIPTOR_LEN] = [0; DESCRIPTOR_LEN];
    let (queries, _) = rows.as_chunks::<DESCRIPTOR_LEN>();
    let blocks = packed(columns);
    let mut of_rows = Vec::with_capacity(queries.len());
    let mut of_columns = vec![BestLanes::NONE; blocks.len()];
    for (group, queries) in queries.chunks(QUERIES).enumerate() {
        let padded: [&[u8; DESCRIPTOR_LEN]; QUERIES] = std::array::from_fn(|k| queries.get(k).unwrap_or(&ZERO));
        let mut best = [BestLanes::NONE; QUERIES];
        let (pairs, _) = blocks.as_chunks::<BLOCKS>();
        for (at, pair) in pairs.iter().enumerate() {
            for (b, products) in products(&padded, pair).iter().enumerate() {
                let block = at * BLOCKS + b;
                for (k, products) in products.iter().enumerate() {
                    best[k].offer(products, block as u16);
                    of_columns[block].offer(products, (group * QUERIES + k) as u16);
                }
            }
        }
        of_rows.extend(best.iter().take(queries.len()).map(BestLanes::merged));
    }
    let one = |(lanes, l): (&BestLanes, usize)| Best {
        index: u32::from(lanes.index[l]),
        first: lanes.first[l],
        second: lanes.second[l],
    };
    let num_columns = columns.len() / DESCRIPTOR_LEN;
    let lanes = of_columns.iter().flat_map(|lanes| (0..LANES).map(move |l| (lanes, l)));
    (of_rows, lanes.take(num_columns).map(one).collect())
}

/// Packs sixteen vectors to a block, with pairs of entries interleaved.
///
/// The number of blocks is padded with zeros to a multiple of [`BLOCKS`].
fn packed(vectors: &[u8]) -> Vec<Block> {
    let (vectors, _) = vectors.as_chunks::<DESCRIPTOR_LEN>();
    let num_blocks = vectors.len().div_ceil(LANES).next_multiple_of(BLOCKS);
    let mut blocks = vec![[[0; 2 * LANES]; DESCRIPTOR_LEN / 2]; num_blocks];
    for (index, vector) in vectors.iter().enumerate() {
        let (block, lane) = (index / LANES, index % LANES);
        for (k, pair) in vector.chunks_exact(2).enumerate() {
            blocks[block][k][2 * lane..2 * lane + 2].copy_from_slice(pair);
        }
    }
    blocks
}

/// Products by the instruction that multiplies bytes and adds neighbors.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn wide_products(
    simd: pulp::x86::V3,
    queries: &[&[u8; DESCRIPTOR_LEN]; QUERIES],
    blocks: &[Block; BLOCKS],
) -> [Products; BLOCKS] {
    let mut sums = [[simd.avx._mm256_setzero_si256(); QUERIES]; BLOCKS];
    for k in 0..DESCRIPTOR_LEN / 2 {
        let entries: [_; BLOCKS] = std::array::from_fn(|b| pulp::cast(blocks[b][k]));
        for q in 0..QUERIES {
            let pair = i16::from_le_bytes([queries[q][2 * k], queries[q][2 * k + 1]]);
            let pair = simd.avx._mm256_set1_epi16(pair);
            for b in 0..BLOCKS {
                let products = simd.avx2._mm256_maddubs_epi16(entries[b], pair);
                sums[b][q] = simd.avx2._mm256_add_epi16(sums[b][q], products);
            }
        }
    }
    sums.map(|sums| sums.map(bytemuck::cast))
}

/// Products by the instruction that multiplies eight bytes and adds the products to eight sums of sixteen bits.
///
/// The two entries of each vector are deinterleaved before.
#[cfg(target_arch = "aarch64")]
#[inline(always)]
fn neon_products(
    simd: pulp::aarch64::Neon,
    queries: &[&[u8; DESCRIPTOR_LEN]; QUERIES],
    blocks: &[Block; BLOCKS],
) -> [Products; BLOCKS] {
    let neon = simd.neon;
    let mut sums = [[[neon.vdupq_n_u16(0); 2]; QUERIES]; BLOCKS];
    for k in 0..DESCRIPTOR_LEN / 2 {
        let entries: [_; BLOCKS] = std::array::from_fn(|b| {
            let [low, high] = bytemuck::cast(blocks[b][k]);
            [neon.vuzp1q_u8(low, high), neon.vuzp2q_u8(low, high)]
        });
        for q in 0..QUERIES {
            for (e, &entry) in queries[q][2 * k..2 * k + 2].iter().enumerate() {
                let entry = neon.vdupq_n_u8(entry);
                for b in 0..BLOCKS {
                    let [low, high] = sums[b][q];
                    let half = neon.vget_low_u8(entries[b][e]);
                    let low = neon.vmlal_u8(low, half, neon.vget_low_u8(entry));
                    sums[b][q] = [low, neon.vmlal_high_u8(high, entries[b][e], entry)];
                }
            }
        }
    }
    sums.map(|sums| sums.map(bytemuck::cast))
}

/// Products by plain arithmetic.
#[inline(always)]
fn plain_products(queries: &[&[u8; DESCRIPTOR_LEN]; QUERIES], blocks: &[Block; BLOCKS]) -> [Products; BLOCKS] {
    let mut sums = [[[0i16; LANES]; QUERIES]; BLOCKS];
    for (sums, block) in sums.iter_mut().zip(blocks) {
        for (k, entries) in block.iter().enumerate() {
            for (sums, query) in sums.iter_mut().zip(queries) {
                let (a, b) = (i16::from(query[2 * k]), i16::from(query[2 * k + 1]));
                for l in 0..LANES {
                    let [first, second] = [entries[2 * l], entries[2 * l + 1]].map(i16::from);
                    sums[l] = sums[l].wrapping_add(a.wrapping_mul(first).wrapping_add(b.wrapping_mul(second)));
                }
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use rand::Rng as _;

    fn vectors(n: usize, seed: u64) -> Vec<u8> {
        let mut rng = seeded_rng(seed, 0);
        // Lengths stay below 181, as those of descriptors do.
        (0..n * DESCRIPTOR_LEN).map(|_| rng.random_range(0..28)).collect()
    }

    fn naive(rows: &[u8], columns: &[u8]) -> Vec<Best> {
        let product =
            |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| i32::from(*a) * i32::from(*b)).sum::<i32>() as i16;
        rows.chunks(DESCRIPTOR_LEN)
            .map(|row| {
                let mut best = Best { index: u32::MAX, first: -1, second: -1 };
                for (j, column) in columns.chunks(DESCRIPTOR_LEN).enumerate() {
                    let value = product(row, column);
                    if value > best.first {
                        best = Best { index: j as u32, first: value, second: best.first };
                    } else {
                        best.second = best.second.max(value);
                    }
                }
                best
            })
            .collect()
    }

    #[test]
    fn the_best_are_those_of_the_definition_whatever_the_instructions() {
        for (n, m) in [(1, 1), (5, 33), (70, 47), (64, 64)] {
            let (rows, columns) = (vectors(n, 1), vectors(m, 2));
            let expected = (naive(&rows, &columns), naive(&columns, &rows));
            let mut found = vec![best(&rows, &columns), best_with(&rows, &columns, plain_products)];
            for (of_rows, of_columns) in &mut found {
                // With only one candidate, the padding is the second.
                for best in of_rows.iter_mut().chain(of_columns.iter_mut()) {
                    if n.min(m) == 1 && best.second == 0 {
                        best.second = -1;
                    }
                }
            }
            assert_eq!(found[0], expected, "{n} x {m}");
            assert_eq!(found[1], expected, "{n} x {m}");
        }
        assert_eq!(best(&[], &vectors(3, 1)).0, []);
        assert_eq!(best(&vectors(3, 1), &[]).1, []);
    }
}
