//! The banded system against dense matrices.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use evcal_geometry::numerics::random::uniform_in;

const ORDER: usize = 4;
const POINTS: [usize; 2] = [9, 6];
const WIDTH: usize = 37;

/// Rows of two kinds of observations, which have the first 20 and the last 22 columns of the border, as `(segment, first control
/// point, first column, rows)`. The last number of a row is its residual.
fn observations() -> Vec<(usize, usize, usize, DMatrix<f64>)> {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut of = |segment: usize, first: usize, at: usize, columns: usize| {
        let rows = DMatrix::from_fn(POINT * ORDER + columns + 1, 30, |_, _| uniform_in(&mut random, -1.0, 1.0));
        (segment, first, at, rows)
    };
    let spans = || {
        POINTS.iter().enumerate().flat_map(|(segment, count)| (0..=count - ORDER).map(move |first| (segment, first)))
    };
    spans()
        .map(|(segment, first)| of(segment, first, 0, 20))
        .collect::<Vec<_>>()
        .into_iter()
        .chain(spans().map(|(segment, first)| of(segment, first, 15, 22)).collect::<Vec<_>>())
        .collect()
}

fn pieces() -> Vec<Equations> {
    let piece = |(segment, first, at, rows): (usize, usize, usize, DMatrix<f64>)| {
        let columns = at..at + rows.nrows() - POINT * ORDER - 1;
        let empty = Equations::new(segment, 0.1 * first as f64, columns, Band::new(0, 0, ORDER, 0));
        let residuals = rows.row(rows.nrows() - 1).norm_squared();
        let mut piece = empty.of_gram(first, ORDER, &(&rows * rows.transpose()));
        piece.loss.add_cost(0.5 * residuals);
        piece
    };
    observations().into_iter().map(piece).collect()
}

fn system(pieces: &[Equations]) -> System {
    let mut system = System::new(&POINTS, WIDTH);
    system.add(pieces).unwrap();
    system.close(&[], &[]);
    system
}

/// Matrix and right side of all parameters: control points of both segments, then the border.
fn dense() -> (DMatrix<f64>, DVector<f64>) {
    let starts = [0, POINT * POINTS[0], POINT * (POINTS[0] + POINTS[1])];
    let count = starts[2] + WIDTH;
    let (mut matrix, mut right) = (DMatrix::zeros(count, count), DVector::zeros(count));
    for (segment, first, at, rows) in observations() {
        let place = |column: usize| match column.checked_sub(POINT * ORDER) {
            None => starts[segment] + POINT * first + column,
            Some(column) => starts[2] + at + column,
        };
        for row in rows.column_iter() {
            let residual = row[row.len() - 1];
            for a in 0..row.len() - 1 {
                right[place(a)] -= row[a] * residual;
                for b in 0..row.len() - 1 {
                    matrix[(place(a), place(b))] += row[a] * row[b];
                }
            }
        }
    }
    (matrix, right)
}

#[test]
fn the_step_is_the_solution_of_the_dense_equations() {
    let pieces = pieces();
    let system = system(&pieces);
    let step = system.step(0.0).unwrap();
    let (matrix, right) = dense();
    let wanted = matrix.lu().solve(&right).unwrap();
    let found: Vec<f64> = step.segments.iter().flatten().chain(&step.globals).copied().collect();
    assert!((DVector::from_vec(found) - &wanted).norm() < 1e-6 * wanted.norm());

    // After the step of a quadratic cost nothing is left to gain, and the cost is lower by what was predicted.
    let moved: Vec<Equations> =
        pieces.iter().map(|piece| piece.moved(&step.segments, &step.globals).unwrap()).collect();
    let moved = self::system(&moved);
    assert!((system.cost - moved.cost - step.predicted).abs() < 1e-6 * system.cost);
    assert!(moved.step(0.0).unwrap().predicted < 1e-9 * system.cost);
}

/// The contributions of blocks add up to the dense Schur complement.
#[test]
fn contributions_add_up_to_the_schur_complement() {
    let pieces = pieces();
    let reduced = system(&pieces).into_reduced().unwrap();
    let (matrix, _) = dense();
    let points = matrix.nrows() - WIDTH;
    let border = matrix.view((0, points), (points, WIDTH)).into_owned();
    let follows = matrix.view((0, 0), (points, points)).into_owned().lu().solve(&border).unwrap();
    let wanted = matrix.view((points, points), (WIDTH, WIDTH)) - border.transpose() * follows;
    assert!((reduced.normal() - &wanted).norm() < 1e-6 * wanted.norm());
    let Blocks { times, contributions: blocks } = reduced.into_follows().blocks(&pieces, 0.25).unwrap();
    assert_eq!((blocks.len(), times.len()), (4, 4));
    let sum = PackedContribution::sum(&blocks).unwrap();
    assert!((sum.information - &wanted).norm() < 1e-6 * wanted.norm());
}

#[test]
fn weighted_pieces_count_less() {
    let system = system(&pieces().into_iter().map(|piece| piece.weighted(0.25)).collect::<Vec<_>>());
    assert!((system.cost - 0.25 * self::system(&pieces()).cost).abs() < 1e-9 * system.cost);
    let (whole, quarter) = (self::system(&pieces()).reduced(0.0).unwrap(), system.reduced(0.0).unwrap());
    assert!((whole.normal() * 0.25 - quarter.normal()).norm() < 1e-6 * quarter.normal().norm());
}

/// Equations that do not fit to the system were skipped, although their part of the border was added.
#[test]
fn equations_outside_the_system_are_an_error() {
    let outside = |change: &dyn Fn(&mut Equations)| {
        let mut pieces = pieces();
        change(&mut pieces[3]);
        System::new(&POINTS, WIDTH).add(&pieces)
    };
    assert_eq!(outside(&|_| ()), Ok(()));
    assert_eq!(outside(&|piece| piece.segment = 2), Err(SolveError::OutOfBand));
    assert_eq!(outside(&|piece| piece.band.first = 8), Err(SolveError::OutOfBand));
    assert_eq!(outside(&|piece| piece.columns = 20..40), Err(SolveError::OutOfBand));
    assert_eq!(outside(&|piece| piece.band = Band::new(0, 6, 6, 20)), Err(SolveError::OutOfBand));
    let step = system(&pieces()).step(0.0).unwrap();
    assert!(pieces()[0].moved(&step.segments[..0], &step.globals).is_err_and(|error| error == SolveError::OutOfBand));
}

#[test]
fn parameters_without_observations_are_not_determined() {
    let few: Vec<Equations> = pieces().into_iter().filter(|piece| piece.columns.start == 0).collect();
    assert_eq!(system(&few).step(0.0).err(), Some(SolveError::Singular));
}
