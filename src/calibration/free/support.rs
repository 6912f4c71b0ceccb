//! Which stretches of time the data support: at least two cameras see the thing.

use super::problem::State;
use super::view::View;

/// Longest time between two sightings of a camera over which it counts as seeing, seconds.
pub(super) const SEEING_S: f64 = 0.5;
/// Longest stretch without support that one spline bridges, seconds.
const BRIDGE_S: f64 = 2.0;
/// Shortest supported stretch worth a piece of spline, seconds.
const SHORTEST_S: f64 = 1.0;
/// Room beyond a piece's ends, seconds: offsets move sightings.
const MARGIN_S: f64 = 0.1;

/// Stretches during which each calibrated camera sees, by rising time; empty for the others.
pub(super) struct Support {
    cameras: Vec<Vec<(f64, f64)>>,
    /// Stretches that two cameras see.
    pub shared: Vec<(f64, f64)>,
}

impl Support {
    pub fn new(views: &[View], state: &State) -> Self {
        let cameras: Vec<Vec<(f64, f64)>> = views
            .iter()
            .zip(&state.cameras)
            .map(|(view, camera)| match camera {
                Some(camera) => stretches(view.sightings.iter().map(|s| view.true_s(camera, s)), SEEING_S),
                None => vec![],
            })
            .collect();
        let mut shared = at_least_two(&cameras);
        // A stretch too short for a piece of spline has no curve of its own.
        let pieces = pieces(&shared);
        shared.retain(|(begin, _)| inside(&pieces, *begin));
        Self { cameras, shared }
    }

    /// Seconds that two cameras see.
    pub fn shared_s(&self) -> f64 {
        self.shared.iter().map(|(a, b)| b - a).sum()
    }

    /// Cameras that see at an instant.
    pub fn seeing(&self, t_s: f64) -> usize {
        self.cameras.iter().filter(|c| inside(c, t_s)).count()
    }

    /// Pieces for the spline, margins added.
    pub fn spans(&self) -> Vec<(f64, f64)> {
        let pieces = pieces(&self.shared);
        pieces.iter().map(|(a, b)| (a - MARGIN_S, b + MARGIN_S)).collect()
    }

    /// The views with only the sightings of calibrated cameras inside the spans, at least `apart_s` apart.
    pub fn restricted(&self, views: &[View], state: &State, apart_s: f64) -> Vec<View> {
        let spans = self.spans();
        views
            .iter()
            .zip(&state.cameras)
            .map(|(view, camera)| View {
                sightings: match camera {
                    Some(camera) => {
                        let mut last_s = f64::NEG_INFINITY;
                        let kept = view.sightings.iter().filter(|s| {
                            let keep =
                                s.stamped_s - last_s >= apart_s && inside(&spans, view.true_s(camera, s));
                            if keep {
                                last_s = s.stamped_s;
                            }
                            keep
                        });
                        kept.copied().collect()
                    }
                    None => vec![],
                },
                ..*view
            })
            .collect()
    }
}

/// Whether an instant lies in one of the rising stretches.
pub(super) fn inside(stretches: &[(f64, f64)], t_s: f64) -> bool {
    let next = stretches.partition_point(|s| s.0 <= t_s);
    next > 0 && t_s <= stretches[next - 1].1
}

/// Rising instants (to within a rolling shutter) gathered where neighbours are at most `gap_s` apart.
pub(super) fn stretches(times_s: impl Iterator<Item = f64>, gap_s: f64) -> Vec<(f64, f64)> {
    let mut found: Vec<(f64, f64)> = vec![];
    for t in times_s {
        match found.last_mut() {
            Some(last) if t - last.1 <= gap_s => last.1 = last.1.max(t),
            _ => found.push((t, t)),
        }
    }
    found
}

/// Shared stretches with short breaks bridged and short ones left out.
fn pieces(shared: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut pieces: Vec<(f64, f64)> = vec![];
    for &(begin, end) in shared {
        match pieces.last_mut() {
            Some(last) if begin - last.1 < BRIDGE_S => last.1 = end,
            _ => pieces.push((begin, end)),
        }
    }
    pieces.retain(|(begin, end)| end - begin > SHORTEST_S);
    pieces
}

fn at_least_two(cameras: &[Vec<(f64, f64)>]) -> Vec<(f64, f64)> {
    let mut events: Vec<(f64, i32)> = cameras
        .iter()
        .flatten()
        .flat_map(|&(begin, end)| [(begin, 1), (end, -1)])
        .collect();
    events.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut depth, mut begin) = (0, 0.0);
    let mut shared = vec![];
    for (t, change) in events {
        let before = depth;
        depth += change;
        if before < 2 && depth >= 2 {
            begin = t;
        } else if before >= 2 && depth < 2 && t > begin {
            shared.push((begin, t));
        }
    }
    shared
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_stretches_by_hand() {
        let cameras = [
            vec![(0.0, 4.0), (10.0, 12.0)],
            vec![(1.0, 3.0)],
            vec![(2.0, 11.0)],
        ];
        assert_eq!(at_least_two(&cameras), [(1.0, 4.0), (10.0, 11.0)]);
        assert_eq!(
            stretches([0.0, 0.2, 0.9, 1.0].into_iter(), 0.5),
            [(0.0, 0.2), (0.9, 1.0)]
        );
        assert_eq!(
            pieces(&[(0.0, 0.4), (1.0, 4.0), (10.0, 10.5), (20.0, 22.0)]),
            [(0.0, 4.0), (20.0, 22.0)]
        );
        assert!(inside(&cameras[0], 11.0) && !inside(&cameras[0], 5.0) && !inside(&cameras[0], -1.0));
    }
}
