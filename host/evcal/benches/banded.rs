//! Time of the banded Cholesky at the size of the joint solve: six parameters per control point, cubic.

use divan::Bencher;
use evcal_geometry::numerics::banded::BandedCholesky;

fn main() {
    divan::main();
}

const BANDWIDTH: usize = 6 * 4 - 1;

fn matrix(control_points: usize) -> BandedCholesky {
    let mut matrix = BandedCholesky::zeros(6 * control_points, BANDWIDTH);
    for row in 0..matrix.dimension() {
        for (column, entry) in matrix.row_mut(row).iter_mut().enumerate() {
            *entry = ((row + 3 * column) as f64).sin();
        }
        matrix.add(row, row, 2.0 * BANDWIDTH as f64);
    }
    matrix
}

#[divan::bench(args = [600, 6000])]
fn factor(bencher: Bencher, control_points: usize) {
    bencher.with_inputs(|| matrix(control_points)).bench_values(|mut matrix| matrix.factor());
}

#[divan::bench(args = [600, 6000])]
fn solve_one_column(bencher: Bencher, control_points: usize) {
    let mut matrix = matrix(control_points);
    let _ = matrix.factor();
    bencher.with_inputs(|| vec![1.0; matrix.dimension()]).bench_refs(|column| matrix.solve_in_place(column));
}
