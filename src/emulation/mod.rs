//! A GigE Vision camera in software: real GVCP control, real GVSP packets, recorded or simulated frames.
//!
//! ```text
//! script ─ reader thread ─(bounded)─► sender thread ─ GVSP ─► host
//!                                        ▲ orders (start, stop, resend, faults)
//! host ─ GVCP ─► control thread ─────────┘        discovery thread answers broadcasts
//! ```
//!
//! Hardware is stood in for on the network and not in the code: everything that receives from a camera is tested
//! with this peer. Any 127/8 address serves without privileges. The sender fills packets in groups and hands each
//! group to the kernel as one UDP GSO message, paced to the speed of the link it stands for.

mod camera;
mod clock;
mod control;
mod faults;
mod genicam;
pub mod gvcp;
pub mod gvsp;
mod mangle;
mod packing;
mod registers;
mod script;
mod sender;
mod session;

pub use camera::{Counters, Emulator, EmulatorError, EmulatorOptions, Handing};
pub use faults::{Drill, FaultError, Faults};
pub use mangle::Mangling;
pub use packing::pack;
pub use registers::{Identity, StrangeDescription};
pub use script::{Idle, Pixels, Script, ScriptShape, ScriptedFrame, pattern, repeated};
pub use session::{ScriptError, session_script};
