//! The picture of a ball, sixteen pixels at a time.

use super::*;

#[test]
fn the_exponential_is_that_of_the_library() {
    for k in 0..=4000 {
        let x = -20.0 + 0.01 * k as f32;
        let (ours, theirs) = (f64::from(exp_small(x)), f64::from(x).exp());
        assert!((ours - theirs).abs() < 3e-7 * theirs, "{x}: {ours} {theirs}");
    }
}

#[test]
fn pixels_that_fill_up_a_block_weigh_nothing() {
    let mut p = Parameters::zeros();
    for (i, value) in [
        (0, 5.0),
        (1, 5.0),
        (LEVEL, 120.0),
        (RADIUS, 3.0),
        (STREAK_SCALE, 1.0),
    ] {
        p[i] = value;
    }
    let (sweep, edge) = (
        Sweep::new(Vector2::new(2.0, 1.0), 0.5, &nalgebra::Matrix2::identity()),
        Edge::new(0.5),
    );
    let observations: Vec<Observation> = (0..11)
        .map(|k| Observation {
            at: Vector2::new(f64::from(k), 5.0),
            value: 100.0,
            background: 60.0,
            variance: 4.0,
        })
        .collect();
    let look = Look::new(&p, (&sweep, &edge), (1.0, 2.5));
    let together = linearise(&PixelLanes::new(&observations), &look);
    let (mut gradient, mut cost, mut used) = (Parameters::zeros(), 0.0, 0.0);
    for o in &observations {
        let alone = linearise(&PixelLanes::new(&[*o]), &look);
        gradient += alone.gradient;
        cost += alone.cost;
        used += alone.used;
    }
    let own = locate(&PixelLanes::new(&observations), &look);
    assert_eq!(
        (own.cost, own.squares, own.used),
        (together.cost, together.squares, together.used)
    );
    assert_eq!(
        own.gradient.fixed_rows::<OWN>(0),
        together.gradient.fixed_rows::<OWN>(0)
    );
    assert_eq!(
        own.information.fixed_view::<OWN, OWN>(0, 0),
        together.information.fixed_view::<OWN, OWN>(0, 0)
    );
    assert!((together.gradient - gradient).norm() < 1e-6 * gradient.norm());
    assert!((together.cost - cost).abs() < 1e-6 * cost && together.used == used && used > 5.0);
}
