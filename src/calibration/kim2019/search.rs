//! The two optimisers of the paper through `argmin`: O1 quasi-Newton (BFGS), O2 Nelder–Mead.

use std::cell::RefCell;

use argmin::core::{CostFunction, Error, Executor, Gradient};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::neldermead::NelderMead;
use argmin::solver::quasinewton::BFGS;

/// Which optimiser.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Optimizer {
    /// O1.
    QuasiNewton,
    /// O2.
    NelderMead,
}

/// One evaluation of the cost: delays in frames, cost.
pub type Evaluation = (Vec<f64>, f64);

/// Stands for "no reconstruction": large, finite (argmin panics or stops on errors and NaN).
pub const PENALTY: f64 = 1e6;

/// Half of the step of the central differences, frames.
const GRADIENT_STEP: f64 = 1e-3;

struct Recorded<'a> {
    cost: &'a dyn Fn(&[f64]) -> f64,
    trace: &'a RefCell<Vec<Evaluation>>,
    evaluations_max: usize,
}

impl Recorded<'_> {
    fn at(&self, delays: &[f64]) -> Result<f64, Error> {
        // argmin's line search has no limit of its own: an error ends it. (In the first simplex Nelder–Mead would
        // panic on one, but a budget is larger than a simplex.)
        if self.trace.borrow().len() >= self.evaluations_max {
            return Err(Error::msg("out of evaluations"));
        }
        let cost = (self.cost)(delays);
        let cost = if cost.is_finite() {
            cost.min(PENALTY)
        } else {
            PENALTY
        };
        self.trace.borrow_mut().push((delays.to_vec(), cost));
        Ok(cost)
    }
}

impl CostFunction for Recorded<'_> {
    type Param = Vec<f64>;
    type Output = f64;
    fn cost(&self, delays: &Self::Param) -> Result<f64, Error> {
        self.at(delays)
    }
}

impl Gradient for Recorded<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;
    fn gradient(&self, delays: &Self::Param) -> Result<Vec<f64>, Error> {
        (0..delays.len())
            .map(|k| {
                let side = |h: f64| {
                    let mut moved = delays.clone();
                    moved[k] += h;
                    self.at(&moved)
                };
                let slope = (side(GRADIENT_STEP)? - side(-GRADIENT_STEP)?) / (2.0 * GRADIENT_STEP);
                // At the edge of the penalty the slope means nothing.
                Ok(if slope.abs() < 1e3 { slope } else { 0.0 })
            })
            .collect()
    }
}

/// Every evaluation made from `start` (frames), in order; the caller takes the least.
///
/// The answer is the best evaluation, not the solver's last word: line searches give up near the optimum of a
/// cost that is only piecewise smooth.
pub fn search(
    cost: &dyn Fn(&[f64]) -> f64,
    start: &[f64],
    optimizer: Optimizer,
    evaluations_max: usize,
) -> Vec<Evaluation> {
    let trace: RefCell<Vec<Evaluation>> = RefCell::new(Vec::new());
    let evaluations_max = evaluations_max.max(4 * (start.len() + 1));
    let recorded = || Recorded {
        cost,
        trace: &trace,
        evaluations_max,
    };
    // Whatever the solver reports, the trace has it.
    match optimizer {
        Optimizer::NelderMead => {
            let _outcome = nelder_mead(recorded(), start);
        }
        Optimizer::QuasiNewton => {
            // Where it is stuck at a kink of the cost, it starts afresh from the best point with a shorter first step.
            let mut from = start.to_vec();
            for first_step in [0.5, 0.2, 0.05] {
                let _outcome = quasi_newton(recorded(), &from, first_step);
                if let Some((at, _)) = least(&trace.borrow()) {
                    from.clone_from(at);
                }
            }
        }
    }
    trace.into_inner()
}

fn nelder_mead(problem: Recorded<'_>, start: &[f64]) -> Result<(), Error> {
    // MATLAB's fminsearch starts with 5 % of each coordinate, which at zero is nothing: half a frame is taken.
    let mut simplex = vec![start.to_vec()];
    for k in 0..start.len() {
        let mut corner = start.to_vec();
        corner[k] += 0.5;
        simplex.push(corner);
    }
    let solver = NelderMead::new(simplex).with_sd_tolerance(1e-6)?;
    let iterations = problem.evaluations_max as u64;
    Executor::new(problem, solver)
        .configure(|state| state.max_iters(iterations))
        .run()?;
    Ok(())
}

fn quasi_newton(problem: Recorded<'_>, start: &[f64], first_step: f64) -> Result<(), Error> {
    let n = start.len();
    let slope = problem.gradient(&start.to_vec())?;
    let steepness = slope.iter().map(|g| g * g).sum::<f64>().sqrt().max(1e-6);
    // `first_step` frames downhill.
    let diagonal = first_step / steepness;
    let inverse: Vec<Vec<f64>> = (0..n)
        .map(|i| (0..n).map(|j| if i == j { diagonal } else { 0.0 }).collect())
        .collect();
    // The cost is nearly a cone: far from its tip it has no curvature, and a step that merely descends would turn
    // BFGS's matrix indefinite. The strong Wolfe conditions keep it positive.
    let line = MoreThuenteLineSearch::new().with_c(1e-4, 0.5)?;
    let solver = BFGS::new(line)
        .with_tolerance_grad(1e-6)?
        .with_tolerance_cost(1e-9)?;
    // A third of the budget for each attempt: argmin's line search has no limit of its own.
    let share = Recorded {
        evaluations_max: problem
            .evaluations_max
            .min(problem.trace.borrow().len() + problem.evaluations_max / 3),
        ..problem
    };
    Executor::new(share, solver)
        .configure(|state| state.param(start.to_vec()).inv_hessian(inverse).max_iters(30))
        .run()?;
    Ok(())
}

/// The least of the evaluations.
pub fn least(trace: &[Evaluation]) -> Option<&Evaluation> {
    trace.iter().min_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_find_the_bottom_of_a_bowl_with_a_kink() {
        let bowl = |d: &[f64]| (d[0] - 1.3).abs() * 2.0 + (d[1] + 0.7).powi(2) + 0.1;
        for optimizer in [Optimizer::QuasiNewton, Optimizer::NelderMead] {
            let trace = search(&bowl, &[0.0, 0.0], optimizer, 400);
            let (at, cost) = least(&trace).unwrap();
            assert!(
                (at[0] - 1.3).abs() < 2e-2 && (at[1] + 0.7).abs() < 0.1,
                "{optimizer:?} {at:?}"
            );
            assert!(*cost < 0.16);
        }
    }

    #[test]
    fn a_cost_without_value_ends_the_search_quietly() {
        for optimizer in [Optimizer::QuasiNewton, Optimizer::NelderMead] {
            let trace = search(&|_| f64::NAN, &[0.0], optimizer, 50);
            assert!(trace.iter().all(|(_, c)| *c == PENALTY) && !trace.is_empty());
        }
    }
}
