//! Live cameras through Aravis: GigE Vision. USB3 Vision cameras are listed, and cannot be opened yet: the way from a
//! serial number to an open camera goes by its network address.
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
mod ffi;
mod frame_number;
mod guard;
mod nodes;
mod open;
mod options;
mod pool;
mod probe;
mod ptp;

pub use camera::{CameraMemory, LiveCamera, LiveCounters, LiveFrame, Next, granted_socket_buffer};
pub use description::DescriptionError;
pub use error::LiveError;
pub use ffi::{ListedDevice, list_devices, make_this_thread_realtime};
pub use options::{CameraAddress, LiveOptions, PacketPath, Ptp};
pub use probe::{Found, discover, holder, is_held, ping};
