//! Live cameras through Aravis: GigE Vision by address, serial number or name, and USB3 Vision by serial number.
//!
//! ```text
//! receive thread (Aravis, real-time) ─ whole buffers ─► capture thread ─ LiveFrame ─► readers
//!         ▲                                                 │ ▲                         │ last one drops it
//!         └───────────────── push ──────────────────────────┘ └────── the same buffer ──┘
//! ```
//!
//! A frame is read in the buffer in which the library assembled it; nothing is copied. All unsafe code and the argument
//! for it are in `ffi.rs`. The measured traps that shaped this room (global open lock, slow tear-down, silent loss,
//! packet timeouts made for 20 fps) are named where they are avoided.

mod archive;
mod camera;
mod description;
mod error;
mod features;
mod ffi;
mod frame_number;
mod guard;
mod nodes;
mod open;
mod options;
mod place;
mod pool;
mod probe;
mod ptp;

pub use camera::{
    CameraMemory, LiveCamera, LiveCounters, LiveFrame, Next, ReadyCamera, granted_socket_buffer,
};
pub use description::DescriptionError;
pub use error::LiveError;
pub use ffi::{ListedDevice, enable_fake_camera, list_near_devices, make_this_thread_realtime};
pub use options::{CameraAddress, LiveOptions, PacketPath, Ptp, UsbMode};
pub use place::Place;
pub use probe::{Found, discover, holder, is_held, ping};
