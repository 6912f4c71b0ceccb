//! TrackMan-V3-shaped CSV (domain §5): its column names, order, units and signs.
//!
//! **PlateLocSide, RelSide and HorzBreak have the sign of −x**; `x0 … az0` and `pfxx` that of x.
//! The trajectory's axes are permuted: X = y, Y = z, Z = x; feet and seconds from release, c2 = a/2.

use nalgebra::Vector3;

use crate::flight::{
    FOOT_M, MPH_MPS, NineParameter, PLATE_FRONT_Y_FT, REFERENCE_Y_FT, STATCAST_GRAVITY_FTPS2,
};
use crate::scene::Pitch;

use super::date::UtcDate;
use super::quoted_csv;

/// TrackMan's columns up to the pitch's trajectory, in its order; those of the batted ball stay blank.
const COLUMNS: &str = "PitchNo Date Time PAofInning PitchofPA Pitcher PitcherId PitcherThrows PitcherTeam Batter \
    BatterId BatterSide BatterTeam PitcherSet Inning Top/Bottom Outs Balls Strikes TaggedPitchType \
    AutoPitchType PitchCall KorBB TaggedHitType PlayResult OutsOnPlay RunsScored Notes RelSpeed VertRelAngle \
    HorzRelAngle SpinRate SpinAxis Tilt RelHeight RelSide Extension VertBreak InducedVertBreak HorzBreak \
    PlateLocHeight PlateLocSide ZoneSpeed VertApprAngle HorzApprAngle ZoneTime ExitSpeed Angle Direction \
    HitSpinRate PositionAt110X PositionAt110Y PositionAt110Z Distance LastTrackedDistance Bearing HangTime \
    pfxx pfxz x0 y0 z0 vx0 vy0 vz0 ax0 ay0 az0 HomeTeam AwayTeam Stadium Level League GameID PitchUID \
    EffectiveVelo MaxHeight MeasuredDuration SpeedDrop PitchLastMeasuredX PitchLastMeasuredY \
    PitchLastMeasuredZ ContactPositionX ContactPositionY ContactPositionZ GameUID UTCDate UTCTime \
    LocalDateTime UTCDateTime AutoHitType System HomeTeamForeignID AwayTeamForeignID GameForeignID Catcher \
    CatcherId CatcherThrows CatcherTeam PlayID PitchTrajectoryXc0 PitchTrajectoryXc1 PitchTrajectoryXc2 \
    PitchTrajectoryYc0 PitchTrajectoryYc1 PitchTrajectoryYc2 PitchTrajectoryZc0 PitchTrajectoryZc1 \
    PitchTrajectoryZc2";

/// The whole file, pitches in order.
pub fn csv(pitches: &[Pitch]) -> String {
    let mut text = quoted_csv::line(COLUMNS.split_whitespace().map(Some));
    for pitch in pitches {
        let row = Row::new(pitch);
        let values: Vec<Option<String>> = COLUMNS.split_whitespace().map(|c| row.text(c)).collect();
        text += &quoted_csv::line(values.iter().map(Option::as_deref));
    }
    text
}

/// One pitch in feet, and its nine parameters where the pitch has them.
struct Row<'a> {
    pitch: &'a Pitch,
    release_ft: Vector3<f64>,
    release_velocity_ftps: Vector3<f64>,
    plate_velocity_ftps: Vector3<f64>,
    zone_time_s: f64,
    nine: Option<NineParameter>,
}

impl<'a> Row<'a> {
    fn new(pitch: &'a Pitch) -> Self {
        let feet = |metres: [f64; 3]| Vector3::from(metres) / FOOT_M;
        let release_ft = feet(pitch.release_m);
        Self {
            pitch,
            release_ft,
            release_velocity_ftps: feet(pitch.release_velocity_mps),
            plate_velocity_ftps: feet(pitch.plate_velocity_mps),
            zone_time_s: (pitch.plate_time_ns - pitch.release_time_ns) as f64 / 1e9,
            nine: nine_parameters(pitch, &release_ft),
        }
    }

    fn text(&self, column: &str) -> Option<String> {
        let date = UtcDate::from_unix_nanos(self.pitch.release_time_ns);
        match column {
            "PitchNo" => Some(self.pitch.pitch.to_string()),
            "Date" | "UTCDate" => date.map(|d| d.day()),
            "Time" | "UTCTime" => date.map(|d| d.time()),
            "UTCDateTime" => date.map(|d| format!("{}T{}Z", d.day(), d.time())),
            "System" => Some("pitchd".to_owned()),
            "Tilt" => self.statcast("spin_axis").map(tilt),
            _ => quoted_csv::number(self.number(column)?, 5),
        }
    }

    fn statcast(&self, column: &str) -> Option<f64> {
        self.pitch.statcast.get(column).copied()
    }

    fn number(&self, column: &str) -> Option<f64> {
        let mph = MPH_MPS / FOOT_M;
        let release_speed = self.pitch.release_speed_mps / MPH_MPS;
        let zone_speed = self.plate_velocity_ftps.norm() / mph;
        let [plate_x_m, plate_z_m] = self.pitch.plate_front_m;
        let [break_x_ft, break_z_ft] = self.induced_break_ft();
        let gravity_drop_ft = 0.5 * STATCAST_GRAVITY_FTPS2 * self.zone_time_s * self.zone_time_s;
        Some(match column {
            "RelSpeed" => release_speed,
            "ZoneSpeed" => zone_speed,
            "SpeedDrop" => release_speed - zone_speed,
            "ZoneTime" => self.zone_time_s,
            "VertRelAngle" => angles_deg(&self.release_velocity_ftps)[0],
            "HorzRelAngle" => angles_deg(&self.release_velocity_ftps)[1],
            "VertApprAngle" => angles_deg(&self.plate_velocity_ftps)[0],
            "HorzApprAngle" => angles_deg(&self.plate_velocity_ftps)[1],
            "RelHeight" => self.release_ft.z,
            "RelSide" => -self.release_ft.x,
            "Extension" => 60.5 - self.release_ft.y,
            "PlateLocHeight" => plate_z_m / FOOT_M,
            "PlateLocSide" => -plate_x_m / FOOT_M,
            "HorzBreak" => -12.0 * break_x_ft,
            "InducedVertBreak" => 12.0 * break_z_ft,
            "VertBreak" => 12.0 * (break_z_ft - gravity_drop_ft),
            "SpinAxis" => return self.statcast("spin_axis"),
            _ => return self.nine_parameter_number(column),
        })
    }

    /// Where the ball crosses the plate's front less where it would have, going straight on from release
    /// under gravity alone; feet, x and z.
    /// For a constant acceleration this is Statcast's pfx: x_p − x_r − (vx/vy)·(Y − y_r) = ½(ax − ay·vx/vy)·T².
    fn induced_break_ft(&self) -> [f64; 2] {
        let [plate_x_m, plate_z_m] = self.pitch.plate_front_m;
        let v = &self.release_velocity_ftps;
        let run_ft = PLATE_FRONT_Y_FT - self.release_ft.y;
        let straight = |start_ft: f64, speed_ftps: f64| start_ft + speed_ftps / v.y * run_ft;
        let gravity_drop_ft = 0.5 * STATCAST_GRAVITY_FTPS2 * self.zone_time_s * self.zone_time_s;
        [
            plate_x_m / FOOT_M - straight(self.release_ft.x, v.x),
            plate_z_m / FOOT_M - straight(self.release_ft.z, v.z) + gravity_drop_ft,
        ]
    }

    fn nine_parameter_number(&self, column: &str) -> Option<f64> {
        let nine = self.nine.as_ref()?;
        let (p, v, a) = (&nine.position_ft, &nine.velocity_ftps, &nine.acceleration_ftps2);
        let fixed = match column {
            "x0" => p.x,
            "y0" => p.y,
            "z0" => p.z,
            "vx0" => v.x,
            "vy0" => v.y,
            "vz0" => v.z,
            "ax0" => a.x,
            "ay0" => a.y,
            "az0" => a.z,
            // As PITCHf/x: from y = 40 ft to the plate's front, without gravity.
            "pfxx" => 6.0 * a.x * squared(flight_from_40_ft_s(nine)?),
            "pfxz" => 6.0 * (a.z + STATCAST_GRAVITY_FTPS2) * squared(flight_from_40_ft_s(nine)?),
            _ => return self.trajectory(nine, column),
        };
        Some(fixed)
    }

    /// `PitchTrajectory{X,Y,Z}c{0,1,2}`.
    fn trajectory(&self, nine: &NineParameter, column: &str) -> Option<f64> {
        let release_s = nine.time_at_y(self.release_ft.y)?;
        let mut letters = column.strip_prefix("PitchTrajectory")?.chars();
        let permuted = |v: Vector3<f64>, axis: char| match axis {
            'X' => Some(v.y),
            'Y' => Some(v.z),
            'Z' => Some(v.x),
            _ => None,
        };
        let axis = letters.next()?;
        match letters.as_str() {
            "c0" => permuted(nine.position(release_s), axis),
            "c1" => permuted(nine.velocity(release_s), axis),
            "c2" => permuted(0.5 * nine.acceleration_ftps2, axis),
            _ => None,
        }
    }
}

/// The pitch's nine parameters: x0 and z0 as given, else from the release position.
fn nine_parameters(pitch: &Pitch, release_ft: &Vector3<f64>) -> Option<NineParameter> {
    let column = |name: &str| pitch.statcast.get(name).copied();
    let mut nine = NineParameter {
        position_ft: Vector3::new(0.0, REFERENCE_Y_FT, 0.0),
        velocity_ftps: Vector3::new(column("vx0")?, column("vy0")?, column("vz0")?),
        acceleration_ftps2: Vector3::new(column("ax")?, column("ay")?, column("az")?),
    };
    nine.position_ft = match (column("x0"), column("z0")) {
        (Some(x), Some(z)) => Vector3::new(x, REFERENCE_Y_FT, z),
        _ => {
            let moved = nine.position(nine.time_at_y(release_ft.y)?) - nine.position_ft;
            Vector3::new(release_ft.x - moved.x, REFERENCE_Y_FT, release_ft.z - moved.z)
        }
    };
    Some(nine)
}

fn flight_from_40_ft_s(nine: &NineParameter) -> Option<f64> {
    Some(nine.time_at_y(PLATE_FRONT_Y_FT)? - nine.time_at_y(40.0)?)
}

fn squared(value: f64) -> f64 {
    value * value
}

/// Vertical atan(vz/−vy) and horizontal −atan(vx/−vy) angle, degrees.
fn angles_deg(v: &Vector3<f64>) -> [f64; 2] {
    [
        (v.z / -v.y).atan().to_degrees(),
        -(v.x / -v.y).atan().to_degrees(),
    ]
}

/// Spin axis (180° is backspin) as a clock face to the nearest quarter of an hour: 180° is 12:00, 210° is 1:00.
fn tilt(spin_axis_deg: f64) -> String {
    let quarters = ((spin_axis_deg / 7.5).round() as i64 + 24).rem_euclid(48);
    let hour = if quarters / 4 == 0 { 12 } else { quarters / 4 };
    format!("{hour}:{:02}", quarters % 4 * 15)
}

#[cfg(test)]
mod tests {
    use super::super::fixture;
    use super::*;

    #[track_caller]
    fn assert_columns(real: usize, expected: &[(&str, f64)]) {
        let pitch = fixture::pitch(1, &fixture::REAL[real]);
        let row = Row::new(&pitch);
        for (column, value) in expected {
            let told: f64 = row.text(column).unwrap().parse().unwrap();
            // Five decimals are written; release and plate times are whole nanoseconds (130 ft/s · 1 ns = 1e-7 ft).
            assert!((told - value).abs() < 2e-5, "{column}: {told} instead of {value}");
        }
    }

    #[test]
    fn a_right_hander_s_fastball_by_hand() {
        // domain §4, first row, put through the formulas of §5 by hand.
        assert_columns(
            0,
            &[
                ("RelSpeed", 88.62614),
                ("ZoneSpeed", 80.87156),
                ("SpeedDrop", 7.75458),
                ("ZoneTime", 0.42679),
                // Released at x = −1.03 ft: TrackMan's side is +1.03.
                ("RelSide", 1.03000),
                ("RelHeight", 6.35997),
                ("Extension", 6.19),
                ("PlateLocSide", -0.31431),
                ("PlateLocHeight", 2.78442),
                // pfx −0.270, +1.642 ft.
                ("HorzBreak", 3.24145),
                ("InducedVertBreak", 19.70993),
                ("VertBreak", -15.45257),
                ("VertRelAngle", -2.47672),
                ("HorzRelAngle", -1.74826),
                ("VertApprAngle", -5.39079),
                ("HorzApprAngle", -1.13436),
                ("pfxx", -2.26884),
                ("pfxz", 11.46166),
                ("x0", -0.9001),
                ("y0", 50.0),
                ("az0", -12.9495),
            ],
        );
    }

    #[test]
    fn a_left_hander_s_sinker_has_the_other_signs() {
        assert_columns(
            5,
            &[
                ("RelSide", -1.93999),
                ("PlateLocSide", -1.37781),
                ("HorzBreak", -14.82388),
                ("HorzRelAngle", 1.93649),
                ("HorzApprAngle", -0.85013),
                ("pfxx", 8.51752),
            ],
        );
    }

    #[test]
    fn the_trajectory_s_axes_are_permuted_and_its_square_is_half_the_acceleration() {
        assert_columns(
            0,
            &[
                ("PitchTrajectoryXc0", 54.31),
                ("PitchTrajectoryYc0", 6.35997),
                ("PitchTrajectoryZc0", -1.03000),
                ("PitchTrajectoryXc1", -129.80324),
                ("PitchTrajectoryYc1", -5.61450),
                ("PitchTrajectoryZc1", 3.96191),
                ("PitchTrajectoryXc2", 13.75295),
                ("PitchTrajectoryYc2", -6.47475),
                ("PitchTrajectoryZc2", -1.90275),
            ],
        );
    }

    #[test]
    fn the_break_is_statcast_s_movement_for_a_constant_acceleration() {
        for real in &fixture::REAL {
            let pitch = fixture::pitch(1, real);
            let row = Row::new(&pitch);
            let [x_ft, z_ft] = row.induced_break_ft();
            // Whole nanoseconds of flight time: g·T·1 ns is 1e-8 ft.
            assert!((x_ft - pitch.statcast["pfx_x"]).abs() < 1e-6, "{}", real.0);
            assert!((z_ft - pitch.statcast["pfx_z"]).abs() < 1e-6, "{}", real.0);
        }
    }

    #[test]
    fn the_nine_parameters_follow_from_the_release_where_x0_is_unknown() {
        let mut pitch = fixture::pitch(1, &fixture::REAL[3]);
        pitch.statcast.remove("x0");
        pitch.statcast.remove("z0");
        let row = Row::new(&pitch);
        assert_eq!(row.text("x0").unwrap(), "-1.9511");
        assert_eq!(row.text("z0").unwrap(), "5.7177");
    }

    #[test]
    fn the_clock_face() {
        for (axis, face) in [
            (180.0, "12:00"),
            (0.0, "6:00"),
            (210.0, "1:00"),
            (90.0, "9:00"),
            (359.0, "6:00"),
        ] {
            assert_eq!(tilt(axis), face);
        }
    }

    #[test]
    fn a_pitch_without_statcast_columns_still_has_its_own() {
        let mut pitch = fixture::pitch(1, &fixture::REAL[0]);
        pitch.statcast.clear();
        let text = csv(&[pitch]);
        let mut lines = csv::Reader::from_reader(text.as_bytes());
        let header = lines.headers().unwrap().clone();
        let record = lines.records().next().unwrap().unwrap();
        let get = |name: &str| {
            record
                .get(header.iter().position(|h| h == name).unwrap())
                .unwrap()
                .to_owned()
        };
        assert_eq!(get("PlateLocSide"), "-0.31431");
        assert_eq!(get("Date"), "2026-04-01");
        assert_eq!((get("vx0"), get("SpinRate")), (String::new(), String::new()));
    }
}
