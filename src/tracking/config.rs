//! Settings of one camera's tracker.

/// Settings of one camera's tracker.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackerConfig {
    /// Nominal frame rate, Hz; only the unit of speed and of bridged gaps.
    pub frame_rate_hz: f64,
    /// Longest run of missing frames that a track bridges.
    pub gap_frames_max: u32,
    /// Fewest points of a track.
    pub points_min: usize,
    /// Shortest time from a pitch's first to its last point, seconds.
    pub span_min_s: f64,
    /// Smallest and largest speed of a ball in the image, pixels per frame.
    pub speed_px_per_frame: [f64; 2],
    /// Slowest peak speed of a pitch across the line of sight, in ball radii per second (1000 is 37 m/s). A high
    /// camera behind home sees a 25 m/s lob at 430, a striding foot makes 200.
    pub speed_radii_per_s_min: f64,
    /// Shortest way of a pitch across the line of sight, in ball radii (100 is 3.7 m).
    pub path_radii_min: f64,
    /// Unit vector along which pitches go in the picture, where that is known; what goes another way is no pitch.
    pub pitch_way: Option<[f64; 2]>,
    /// Smallest and largest radius of a ball between the hand and the plate, pixels, where that is known.
    pub ball_radius_px: Option<[f64; 2]>,
    /// Most hypotheses kept alive.
    pub hypotheses_max: usize,
    /// A break between stamps longer than this ends every track, seconds.
    pub break_s: f64,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            frame_rate_hz: 175.0,
            gap_frames_max: 12,
            points_min: 12,
            span_min_s: 0.1,
            speed_px_per_frame: [0.7, 90.0],
            speed_radii_per_s_min: 300.0,
            path_radii_min: 40.0,
            pitch_way: None,
            ball_radius_px: None,
            hypotheses_max: 64,
            break_s: 0.25,
        }
    }
}
