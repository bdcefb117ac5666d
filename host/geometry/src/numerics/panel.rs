//! Several vectors stored next to each other, so that a banded solve or a product processes all of them at once.
//!
//! Every sum is formed in the same order, whatever the machine's vector width.

use multiversion::multiversion;

/// Number of vectors in a panel.
pub const PANEL: usize = 16;

/// Vectors as the [`PANEL`] columns of a matrix; each line is a row of the matrix.
pub type Panel = Vec<[f64; PANEL]>;

/// Replaces each vector b of `panel` by the solution of `L y = b`. For each row of the lower triangle L, `rows`
/// contains the `bandwidth` entries before the diagonal and the reciprocal of the diagonal.
#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
pub fn forward(rows: &[f64], bandwidth: usize, panel: &mut [[f64; PANEL]]) {
    for (i, row) in rows.chunks_exact(bandwidth + 1).enumerate() {
        let count = bandwidth.min(i);
        let (solved, open) = panel.split_at_mut(i);
        let Some(line) = open.first_mut() else { return };
        let (entries, reciprocal) = (&row[bandwidth - count..bandwidth], row[bandwidth]);
        // Two sums, so that an addition does not wait for the previous one.
        let mut sums = [[0.0; PANEL]; 2];
        let (pairs, rest) = entries.as_chunks::<2>();
        let (solved_pairs, solved_rest) = solved[i - count..].as_chunks::<2>();
        for (entries, solved) in pairs.iter().zip(solved_pairs) {
            for lane in 0..PANEL {
                sums[0][lane] += entries[0] * solved[0][lane];
                sums[1][lane] += entries[1] * solved[1][lane];
            }
        }
        for (entry, solved) in rest.iter().zip(solved_rest) {
            for lane in 0..PANEL {
                sums[0][lane] += entry * solved[lane];
            }
        }
        for lane in 0..PANEL {
            line[lane] = (line[lane] - (sums[0][lane] + sums[1][lane])) * reciprocal;
        }
    }
}

/// Replaces each vector y of `panel` by the solution of `Lᵀ x = y`; `rows` are as in [`forward`].
#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
pub fn backward(rows: &[f64], bandwidth: usize, panel: &mut [[f64; PANEL]]) {
    for (i, row) in rows.chunks_exact(bandwidth + 1).enumerate().rev() {
        let count = bandwidth.min(i);
        let (open, solved) = panel.split_at_mut(i);
        let Some(line) = solved.first_mut() else { return };
        for value in line.iter_mut() {
            *value *= row[bandwidth];
        }
        for (open, entry) in open[i - count..].iter_mut().zip(&row[bandwidth - count..bandwidth]) {
            for lane in 0..PANEL {
                open[lane] -= entry * line[lane];
            }
        }
    }
}

/// Returns the products aᵀb of all vectors of panel `a` with all vectors of panel `b`, which has the same number of
/// lines. Each product is summed in the order of the lines, on every machine.
pub fn panel_product(a: &[[f64; PANEL]], b: &[[f64; PANEL]]) -> [[f64; PANEL]; PANEL] {
    let mut sums = [[0.0; PANEL]; PANEL];
    add_products(a, b, &mut sums);
    sums
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn add_products(a: &[[f64; PANEL]], b: &[[f64; PANEL]], sums: &mut [[f64; PANEL]; PANEL]) {
    const TOGETHER: usize = 4;
    let (a_parts, a_rest) = a.as_chunks::<TOGETHER>();
    let (b_parts, b_rest) = b.as_chunks::<TOGETHER>();
    for (a, b) in a_parts.iter().zip(b_parts) {
        for (row, sums) in sums.iter_mut().enumerate() {
            for (lane, sum) in sums.iter_mut().enumerate() {
                for line in 0..TOGETHER {
                    *sum += a[line][row] * b[line][lane];
                }
            }
        }
    }
    for (a, b) in a_rest.iter().zip(b_rest) {
        for (entry, sums) in a.iter().zip(sums.iter_mut()) {
            for (sum, value) in sums.iter_mut().zip(b) {
                *sum += entry * value;
            }
        }
    }
}
