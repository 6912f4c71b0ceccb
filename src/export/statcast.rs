//! Statcast-shaped CSV (domain §4): the public file's column names, order and units.
//!
//! Unknown values are blank. After the public columns stand pitchd's own: `plate_plane` says at which plane
//! `plate_x`, `plate_z` and `zone` are stated, for the public file moved it in 2026 and does not say.

use crate::flight::{FOOT_M, MPH_MPS, StrikeZone};
use crate::scene::{Pitch, PitchQuality};

use super::date::UtcDate;
use super::quoted_csv;

/// Where `plate_x` and `plate_z` are stated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlatePlane {
    /// y = 17/12 ft, the plate's front edge: the public file through the 2025 season.
    #[default]
    Front,
    /// y = 8.5/12 ft, the plate's middle: the public file from 2026.
    Middle,
}

impl PlatePlane {
    /// As the column `plate_plane` and the option `--plane` have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Middle => "middle",
        }
    }

    /// x and z of the pitch there, metres.
    pub fn crossing_m(self, pitch: &Pitch) -> [f64; 2] {
        match self {
            Self::Front => pitch.plate_front_m,
            Self::Middle => pitch.plate_mid_m,
        }
    }

    /// 1σ of x and z there, metres.
    pub fn sigma_m(self, pitch: &Pitch) -> [f64; 2] {
        match self {
            Self::Front => pitch.sigma.plate_front_m,
            Self::Middle => pitch.sigma.plate_mid_m,
        }
    }
}

/// The public file's columns, in its order (2025).
const COLUMNS: &str = "pitch_type game_date release_speed release_pos_x release_pos_z player_name batter pitcher \
    events description spin_dir spin_rate_deprecated break_angle_deprecated break_length_deprecated zone des \
    game_type stand p_throws home_team away_team type hit_location bb_type balls strikes game_year pfx_x pfx_z \
    plate_x plate_z on_3b on_2b on_1b outs_when_up inning inning_topbot hc_x hc_y tfs_deprecated \
    tfs_zulu_deprecated umpire sv_id vx0 vy0 vz0 ax ay az sz_top sz_bot hit_distance_sc launch_speed \
    launch_angle effective_speed release_spin_rate release_extension game_pk fielder_2 fielder_3 fielder_4 \
    fielder_5 fielder_6 fielder_7 fielder_8 fielder_9 release_pos_y estimated_ba_using_speedangle \
    estimated_woba_using_speedangle woba_value woba_denom babip_value iso_value launch_speed_angle \
    at_bat_number pitch_number pitch_name home_score away_score bat_score fld_score post_away_score \
    post_home_score post_bat_score post_fld_score if_fielding_alignment of_fielding_alignment spin_axis \
    delta_home_win_exp delta_run_exp bat_speed swing_length estimated_slg_using_speedangle \
    delta_pitcher_run_exp hyper_speed home_score_diff bat_score_diff home_win_exp bat_win_exp age_pit_legacy \
    age_bat_legacy age_pit age_bat n_thruorder_pitcher n_priorpa_thisgame_player_at_bat \
    pitcher_days_since_prev_game batter_days_since_prev_game pitcher_days_until_next_game \
    batter_days_until_next_game api_break_z_with_gravity api_break_x_arm api_break_x_batter_in arm_angle \
    attack_angle attack_direction swing_path_tilt intercept_ball_minus_batter_pos_x_inches \
    intercept_ball_minus_batter_pos_y_inches";

/// pitchd's own columns after the public ones: the session's pitch number (the key to `pitches.jsonl`), the
/// plane, 1σ in the column's units (ft, mph), and the strike call at mid-plate.
const OWN_COLUMNS: &str = "pitch plate_plane plate_x_sigma plate_z_sigma release_speed_sigma \
    strike_probability strike_margin_mm quality";

/// The whole file. Pitches in order; a byte-order mark first, as the public file has it.
pub fn csv(pitches: &[Pitch], plane: PlatePlane) -> String {
    let known: Vec<&str> = COLUMNS
        .split_whitespace()
        .chain(OWN_COLUMNS.split_whitespace())
        .collect();
    let mut columns = known.clone();
    // The pitch's map is open: what the public file lacks (x0, y0, z0, …) stands last.
    let mut more: Vec<&str> = pitches
        .iter()
        .flat_map(|p| p.statcast.keys().map(String::as_str))
        .filter(|name| !known.contains(name))
        .collect();
    more.sort_unstable();
    more.dedup();
    columns.extend(more);

    let mut text = "\u{feff}".to_owned();
    text += &quoted_csv::line(columns.iter().map(|c| Some(*c)));
    for pitch in pitches {
        let values: Vec<Option<String>> = columns.iter().map(|c| value(pitch, plane, c)).collect();
        text += &quoted_csv::line(values.iter().map(Option::as_deref));
    }
    text
}

/// One value as text; `None` where it is unknown.
fn value(pitch: &Pitch, plane: PlatePlane, column: &str) -> Option<String> {
    let date = || UtcDate::from_unix_nanos(pitch.release_time_ns);
    match column {
        "game_date" => return date().map(|d| d.day()),
        "game_year" => return date().map(|d| d.year()),
        "plate_plane" => return Some(plane.name().to_owned()),
        "quality" => return Some(quality_name(pitch.quality).to_owned()),
        _ => {}
    }
    let decimals = match column {
        "pitch" | "zone" | "spin_axis" => 0,
        "strike_margin_mm" => 2,
        "vx0" | "vy0" | "vz0" | "ax" | "ay" | "az" => 6,
        // 0.0001 ft is 0.03 mm: two places, as the public file has them, would cost 1.5 mm.
        _ => 4,
    };
    quoted_csv::number(numeric(pitch, plane, column)?, decimals)
}

fn numeric(pitch: &Pitch, plane: PlatePlane, column: &str) -> Option<f64> {
    let [x_m, z_m] = plane.crossing_m(pitch);
    let [sigma_x_m, sigma_z_m] = plane.sigma_m(pitch);
    let fixed = match column {
        "pitch" => f64::from(pitch.pitch),
        "plate_x" => x_m / FOOT_M,
        "plate_z" => z_m / FOOT_M,
        "plate_x_sigma" => sigma_x_m / FOOT_M,
        "plate_z_sigma" => sigma_z_m / FOOT_M,
        "release_speed_sigma" => pitch.sigma.release_speed_mps / MPH_MPS,
        "strike_probability" => pitch.strike_probability,
        "strike_margin_mm" => 1e3 * pitch.strike_margin_m,
        "zone" => return zone(pitch, plane),
        _ => {
            return pitch
                .statcast
                .get(column)
                .copied()
                .or_else(|| from_release(pitch, column));
        }
    };
    Some(fixed)
}

/// Columns that follow from the release alone, where the map does not have them.
fn from_release(pitch: &Pitch, column: &str) -> Option<f64> {
    let [x_m, y_m, z_m] = pitch.release_m;
    Some(match column {
        "release_speed" => pitch.release_speed_mps / MPH_MPS,
        "release_pos_x" => x_m / FOOT_M,
        "release_pos_y" => y_m / FOOT_M,
        "release_pos_z" => z_m / FOOT_M,
        "release_extension" => 60.5 - y_m / FOOT_M,
        _ => return None,
    })
}

/// Zone number at the plane the file states.
fn zone(pitch: &Pitch, plane: PlatePlane) -> Option<f64> {
    let zone = StrikeZone {
        top_m: pitch.statcast.get("sz_top")? * FOOT_M,
        bottom_m: pitch.statcast.get("sz_bot")? * FOOT_M,
    };
    let [x_m, z_m] = plane.crossing_m(pitch);
    Some(f64::from(zone.statcast_zone(x_m / FOOT_M, z_m / FOOT_M)))
}

/// As `pitches.jsonl` has it.
pub(super) fn quality_name(quality: PitchQuality) -> &'static str {
    match quality {
        PitchQuality::Good => "good",
        PitchQuality::Degraded => "degraded",
        PitchQuality::Poor => "poor",
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture;
    use super::*;

    /// The first pitch's value of a column, read by a CSV reader of another make.
    fn read(text: &str, column: &str) -> String {
        let text = text.strip_prefix('\u{feff}').unwrap();
        let mut lines = csv::Reader::from_reader(text.as_bytes());
        let at = lines.headers().unwrap().iter().position(|h| h == column).unwrap();
        lines
            .records()
            .next()
            .unwrap()
            .unwrap()
            .get(at)
            .unwrap()
            .to_owned()
    }

    #[test]
    fn the_plane_is_a_named_choice_and_is_told() {
        let pitches = [fixture::pitch(1, &fixture::REAL[0])];
        // domain §4, first row: 0.314 2.784 at 17/12 ft, 0.328 2.717 at 8.5/12 ft.
        for (plane, name, x, z) in [
            (PlatePlane::Front, "front", 0.314, 2.784),
            (PlatePlane::Middle, "middle", 0.328, 2.717),
        ] {
            let text = csv(&pitches, plane);
            assert_eq!(read(&text, "plate_plane"), name);
            let number = |column: &str| read(&text, column).parse::<f64>().unwrap();
            assert!((number("plate_x") - x).abs() < 6e-4);
            assert!((number("plate_z") - z).abs() < 6e-4);
            // Zone of [1.48, 3.52] ft × ±0.83 ft in thirds: 2.7 is in the middle row, 0.31 in the right column.
            assert_eq!(read(&text, "zone"), "6");
        }
    }

    #[test]
    fn columns_are_the_public_file_s_first() {
        let text = csv(&fixture::pitches(), PlatePlane::Front);
        assert!(text.starts_with(
            "\u{feff}\"pitch_type\",\"game_date\",\"release_speed\",\"release_pos_x\",\"release_pos_z\","
        ));
        // 118 public columns (2025), 8 of ours, then x0 y0 z0 of the pitch's own map.
        let header = text.lines().next().unwrap();
        assert_eq!(header.split(',').count(), 118 + 8 + 3);
        assert!(header.ends_with("\"quality\",\"x0\",\"y0\",\"z0\""));
        assert_eq!(text.lines().count(), 7);
        assert!(
            text.lines()
                .skip(1)
                .all(|line| line.starts_with(",\"2026-04-01\",\""))
        );
    }

    #[test]
    fn what_follows_from_the_release_is_filled_in_and_the_rest_is_blank() {
        let mut pitch = fixture::pitch(1, &fixture::REAL[0]);
        pitch.statcast.clear();
        let text = csv(&[pitch], PlatePlane::Front);
        assert_eq!(read(&text, "release_extension"), "6.19");
        assert_eq!(read(&text, "release_pos_x"), "-1.03");
        assert_eq!(read(&text, "release_speed"), "88.6261");
        for column in ["pfx_x", "zone", "spin_axis", "player_name"] {
            assert_eq!(read(&text, column), "");
        }
    }
}
