//! Tracks and the latest calibration in, 3-D flight and pitch numbers out.

mod nine_parameter;
mod zone;

pub use nine_parameter::{
    FOOT_M, MPH_MPS, Movement, NineParameter, PLATE_FRONT_Y_FT, PLATE_MIDDLE_Y_FT, REFERENCE_Y_FT,
    STATCAST_GRAVITY_FTPS2,
};
pub use zone::{BALL_RADIUS_M, HALF_PLATE_M, StrikeZone};
