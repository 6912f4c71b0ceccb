//! What the page's numbers mean: axes, planes, signs and sigmas.

use crate::scene::{Calibration, WorldFrame};

/// Statements about axes and signs for a page of pitches.
pub(super) fn of_pitches(calibration: &Calibration) -> String {
    section(
        calibration,
        "<li><b>Plate planes</b>: front y = 43.2 cm (17/12 ft), middle y = 21.6 cm (8.5/12 ft). Strikes are called at the \
         middle: any part of the ball in a flat zone as wide as the plate. In <code>pitches.csv</code> the column \
         <code>plate_plane</code> says where <code>plate_x</code> and <code>plate_z</code> are stated.</li>\
         <li><b>Break</b> is Statcast’s pfx: release to the plate’s front, without gravity, positive to catcher’s right \
         and up.</li><li>1 ft = 0.3048 m, 1 mph = 0.44704 m/s.</li>",
    )
}

/// Statements about axes and signs for a page of one trajectory.
pub(super) fn of_trajectory(calibration: &Calibration) -> String {
    section(
        calibration,
        "<li><b>Times</b> are the reference camera’s: one row of <code>trajectory.csv</code> for each of its frames, \
         <code>time_ns</code> in nanoseconds of its stamps; <code>cameras</code> counts those that saw the object then.</li>",
    )
}

fn section(calibration: &Calibration, more_html: &str) -> String {
    let world = match calibration.world {
        WorldFrame::HomePlate => {
            "<b>Home plate frame: x to catcher’s right</b> (first-base side), y toward the pitcher, z up; right-handed, \
             metres. The origin is the back tip of home plate, on the ground."
        }
        WorldFrame::ReferenceCamera => {
            "<b>The reference camera’s frame</b>: the origin is that camera, because nothing ties these poses to a \
             home plate. Lengths are metres only when gravity or a measured distance fixes the scale."
        }
    };
    let sigma = if calibration.covariance.is_empty() {
        "is one standard deviation of the flight alone: <b>the calibration is taken as exact</b>, because it has \
         no covariance"
    } else {
        "is one standard deviation and includes the uncertainty of the calibration"
    };
    format!(
        "<section><h2>What the numbers mean</h2>\n<ul class=\"plain\"><li>{world}</li>{more_html}\
         <li><b>Delay τ</b>: true exposure midpoint = stamped midpoint − τ; 0 for the reference camera. \
         τ &gt; 0: the frame stamped t shows the ball where it was at t − τ.</li>\
         <li><b>Residual</b> = predicted − observed, in distorted pixels; the centre of the top-left pixel is (0, 0). \
         RMS is that of the residual’s length.</li>\
         <li><b>±</b> {sigma}; ellipses hold 95 %.</li>\
         </ul></section>\n"
    )
}
