//! The only unsafe code about cameras: what the `aravis` crate does not offer, or offers unsoundly.
//!
//! # Why this is sound
//! * **Threads.** Aravis asks that one object is not used from two threads at once; only pushing and popping of a
//!   stream's buffers is free of that (its queues are `GAsyncQueue`s). The crate's `Camera`, `Stream` and `Buffer` are
//!   `Send + Clone`, so two threads *could* call one object from safe code. Here none is ever cloned, and all of them
//!   stay inside [`RawStream`] and the opened camera, which one thread owns at a time.
//! * **Buffers.** A popped buffer belongs to us until it is pushed back: the receive thread does not touch it. A
//!   [`PooledFrame`] owns the only reference that anybody but the library's dead queues could have; what is shared
//!   between threads is the byte slice alone, which nobody writes until the last reader lets go and the owner thread
//!   pushes the buffer back. `Buffer::new_preallocated_owned` (a safe function that trusts any pointer) is not used.
//! * **Callbacks.** The stream's callback runs on the receive thread, takes no pointer of ours (the priority travels
//!   as the value of the pointer), acts on the INIT event alone, and cannot panic across the border.
//! * **File descriptors.** The stream's socket is found by its port among this process's own and borrowed for one call.
//! * **Global state.** Discovery through the library changes lists that opening reads: both hold [`DEVICE_LIST`].

#![allow(unsafe_code, reason = "the border to Aravis; every block says why it holds")]

use std::ffi::CStr;
use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::ops::Deref;
use std::os::fd::BorrowedFd;
use std::os::raw::{c_char, c_void};
use std::ptr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use aravis::glib::object::Cast;
use aravis::glib::translate::{ToGlibPtr, from_glib_full};
use aravis::glib::{self};
use aravis::prelude::*;
use aravis::{Buffer, BufferStatus, Camera, GvStream, Stream};
use crossbeam_channel::Sender;
use socket2::{SockFilter, SockRef, Type};

/// One at a time through the library's lists of devices. Its own lock is around every open in any case.
static DEVICE_LIST: Mutex<()> = Mutex::new(());
/// Whether the library's own fake cameras are there.
static FAKES: AtomicBool = AtomicBool::new(false);

/// Opens the device with this name.
///
/// # Errors
/// What the library says.
pub fn open_device(name: &str) -> Result<Camera, glib::Error> {
    let _one_at_a_time = DEVICE_LIST.lock();
    Camera::new(Some(name))
}

/// Lets the library's own fake camera (serial 1) be found, for tests of what is not GigE Vision.
pub fn enable_fake_camera() {
    let _one_at_a_time = DEVICE_LIST.lock();
    // SAFETY: a constant string that ends with a zero; nobody opens or lists meanwhile.
    unsafe { aravis_sys::arv_enable_interface(c"Fake".as_ptr()) };
    FAKES.store(true, Ordering::Relaxed);
}

/// A stream whose receive thread was made real-time as it began.
pub struct RawStream(Stream);

/// Runs on the receive thread; `data` is the wanted priority, not an address.
unsafe extern "C" fn on_stream_event(
    data: *mut c_void,
    event: aravis_sys::ArvStreamCallbackType,
    _buffer: *mut aravis_sys::ArvBuffer,
) {
    if event == aravis_sys::ARV_STREAM_CALLBACK_TYPE_INIT && !data.is_null() {
        let priority = i32::try_from(data as usize).unwrap_or(1).clamp(1, 99);
        // SAFETY: no arguments but a number; acts on the calling thread.
        unsafe {
            aravis_sys::arv_make_thread_realtime(priority);
        }
    }
}

impl RawStream {
    /// Creates the stream of a camera; its receive thread gets `realtime_priority` if the system allows.
    ///
    /// # Errors
    /// What the library says.
    pub fn create(camera: &Camera, realtime_priority: Option<u8>) -> Result<Self, glib::Error> {
        let priority = usize::from(realtime_priority.unwrap_or(0));
        let mut error = ptr::null_mut();
        // SAFETY: the camera is alive for the call; the callback is a plain function that stays for ever and takes
        // `priority` as a value; `error` is a valid place. A stream or an error is handed to us, owned.
        unsafe {
            let stream = aravis_sys::arv_camera_create_stream(
                camera.to_glib_none().0,
                Some(on_stream_event),
                ptr::without_provenance_mut(priority),
                &mut error,
            );
            if !error.is_null() {
                return Err(from_glib_full(error));
            }
            if stream.is_null() {
                return Err(glib::Error::new(
                    aravis::DeviceError::Unknown,
                    "no stream and no reason",
                ));
            }
            Ok(Self(from_glib_full(stream)))
        }
    }

    /// The GigE Vision side of the stream, for its settings; `None` for USB.
    pub fn gige(&self) -> Option<&GvStream> {
        self.0.downcast_ref::<GvStream>()
    }

    /// Attaches a filter to the socket on which this stream's packets come.
    ///
    /// # Errors
    /// No such socket, or the kernel refuses.
    pub fn attach(&self, camera: Ipv4Addr, program: &[SockFilter]) -> io::Result<()> {
        self.with_socket(camera, |socket| socket.attach_filter(program))
    }

    /// Asks for a receive buffer on that socket and answers what the kernel grants.
    ///
    /// # Errors
    /// No such socket, or the kernel refuses.
    pub fn grant_buffer(&self, camera: Ipv4Addr, asked_bytes: usize) -> io::Result<usize> {
        self.with_socket(camera, |socket| receive_buffer(socket, asked_bytes))
    }

    /// The library tells the port and not the socket: it is the one of this process that is bound to that port on the
    /// side that faces the camera. USB has none.
    fn with_socket<T>(
        &self,
        camera: Ipv4Addr,
        work: impl FnOnce(&SockRef<'_>) -> io::Result<T>,
    ) -> io::Result<T> {
        let not_found = || io::Error::new(io::ErrorKind::NotFound, "the stream's socket was not found");
        let port = self.gige().ok_or_else(not_found)?.port();
        let side = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        side.connect((camera, port))?;
        let side = side.local_addr()?.ip();
        let mut with_port = Vec::new();
        for entry in std::fs::read_dir("/proc/self/fd")?.flatten() {
            let target = std::fs::read_link(entry.path()).unwrap_or_default();
            let number = entry.file_name().to_str().and_then(|name| name.parse().ok());
            let (Some(number), true) = (number, target.to_string_lossy().starts_with("socket:")) else {
                continue;
            };
            // SAFETY: nothing is closed or kept: the number is asked for its address and kind. One that was closed
            // meanwhile answers with an error, or as another socket, with another address.
            let socket = unsafe { BorrowedFd::borrow_raw(number) };
            let socket = SockRef::from(&socket);
            let address = socket.local_addr().ok().and_then(|a| a.as_socket());
            let is_udp = socket.r#type().is_ok_and(|kind| kind == Type::DGRAM);
            if let Some(address) = address.filter(|a| is_udp && a.port() == port) {
                with_port.push((number, address.ip()));
            }
        }
        // Two interfaces in one network: the route may be by the other, but the port is seldom there twice.
        let faces = with_port
            .iter()
            .find(|(_, ip)| *ip == side || ip.is_unspecified());
        let only = with_port.first().filter(|_| with_port.len() == 1);
        let Some((number, _)) = faces.or(only) else {
            return Err(not_found());
        };
        // SAFETY: as above; the stream is alive and has this address, so that no other socket can have it.
        let socket = unsafe { BorrowedFd::borrow_raw(*number) };
        work(&SockRef::from(&socket))
    }

    /// Gives a buffer to the receive thread.
    pub fn push(&self, buffer: Buffer) {
        self.0.push_buffer(buffer);
    }

    /// Waits for a buffer.
    pub fn pop(&self, timeout_us: u64) -> Option<Buffer> {
        self.0.timeout_pop_buffer(timeout_us)
    }

    /// One of the library's counters by name.
    pub fn counter(&self, name: &str) -> u64 {
        self.0.info_uint64_by_name(name)
    }
}

/// Sets a socket's receive buffer and answers what the kernel grants: it says nothing where that is less.
///
/// # Errors
/// What the kernel says.
pub fn receive_buffer(socket: &SockRef<'_>, asked_bytes: usize) -> io::Result<usize> {
    socket.set_recv_buffer_size(asked_bytes)?;
    // The kernel answers twice what it books for payload.
    Ok(socket.recv_buffer_size()? / 2)
}

/// A buffer with the size of its memory: the library tells only how much of it the last frame has filled.
pub struct SizedBuffer {
    /// The buffer.
    pub buffer: Buffer,
    /// Size of its memory.
    pub bytes: usize,
}

/// Memory for one frame, written to: pages that come one by one under the first frames cost the receive thread a
/// second of them.
pub fn touched_buffer(payload_bytes: usize) -> Buffer {
    const PAGE_BYTES: usize = 4096;
    let buffer = Buffer::new_allocate(payload_bytes);
    // The size with it is of what was received: nothing yet.
    let (bytes, _) = buffer.data();
    if !bytes.is_null() {
        for at in (0..payload_bytes).step_by(PAGE_BYTES) {
            // SAFETY: the library has just allocated `payload_bytes` for this buffer, which nobody else knows of.
            unsafe { ptr::write_volatile(bytes.add(at), 0) };
        }
    }
    buffer
}

/// Makes the calling thread real-time (SCHED_RR), if the system allows it; answers whether it did.
pub fn make_this_thread_realtime(priority: u8) -> bool {
    let priority = i32::from(priority).clamp(1, 99);
    // SAFETY: no arguments but a number; acts on the calling thread.
    unsafe { aravis_sys::arv_make_thread_realtime(priority) != 0 }
}

/// The pixels of a frame in the buffer that the receive thread filled. Dropping it sends the buffer home.
pub struct PooledFrame {
    buffer: Option<SizedBuffer>,
    bytes: *const u8,
    count: usize,
    home: Sender<SizedBuffer>,
}

// SAFETY: the raw pointer is into memory that the buffer owns, and the buffer may move between threads (its
// reference count is atomic, nobody else uses it). Shared access reads plain bytes and calls nothing.
unsafe impl Send for PooledFrame {}
// SAFETY: as above: `&PooledFrame` gives `&[u8]` and nothing of the GObject.
unsafe impl Sync for PooledFrame {}

impl PooledFrame {
    /// Wraps a complete popped buffer of at least `count` bytes; gives it back if it is not that.
    ///
    /// # Errors
    /// The buffer itself, to be pushed again.
    pub fn new(buffer: SizedBuffer, count: usize, home: Sender<SizedBuffer>) -> Result<Self, Buffer> {
        let (bytes, received) = buffer.buffer.data();
        if buffer.buffer.status() != BufferStatus::Success || bytes.is_null() || received < count {
            return Err(buffer.buffer);
        }
        Ok(Self {
            buffer: Some(buffer),
            bytes,
            count,
            home,
        })
    }
}

impl Deref for PooledFrame {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        // SAFETY: `new` saw `count` received bytes at `bytes`; the buffer owns them, lives as long as `self`, and is
        // written by nobody until it is pushed to a stream, which `drop` alone sets off.
        unsafe { std::slice::from_raw_parts(self.bytes, self.count) }
    }
}

impl Drop for PooledFrame {
    fn drop(&mut self) {
        if let Some(buffer) = self.buffer.take() {
            // A pool that is gone needs no buffers: then this one is freed here.
            let _ = self.home.send(buffer);
        }
    }
}

/// A camera as the library's own discovery found it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedDevice {
    /// `Vendor-Model-Serial`.
    pub id: String,
    /// Vendor.
    pub vendor: String,
    /// Model.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// USB bus path.
    pub address: String,
    /// `USB3Vision`.
    pub protocol: String,
}

/// The cameras that are not on the network: those of the USB bus, and the fake one where it is enabled.
pub fn list_near_devices() -> Vec<ListedDevice> {
    let _one_at_a_time = DEVICE_LIST.lock();
    // SAFETY: no arguments; an interface is made once and stays for ever.
    let mut interfaces = vec![unsafe { aravis_sys::arv_uv_interface_get_instance() }];
    if FAKES.load(Ordering::Relaxed) {
        // SAFETY: as above.
        interfaces.push(unsafe { aravis_sys::arv_fake_interface_get_instance() });
    }
    interfaces.retain(|interface| !interface.is_null());
    interfaces.into_iter().flat_map(devices_of).collect()
}

type TextOf = unsafe extern "C" fn(*mut aravis_sys::ArvInterface, u32) -> *const c_char;

/// Called with the lock held, and an interface of the library.
fn devices_of(interface: *mut aravis_sys::ArvInterface) -> Vec<ListedDevice> {
    let text = |of: TextOf, index: u32| {
        // SAFETY: `index` is below the count under the lock; the string belongs to the library and is copied at once.
        let pointer = unsafe { of(interface, index) };
        if pointer.is_null() {
            return String::new();
        }
        // SAFETY: a non-null string of the library ends with a zero.
        unsafe { CStr::from_ptr(pointer) }.to_string_lossy().into_owned()
    };
    // SAFETY: the interface is alive, and only the holder of the lock touches its list.
    let count = unsafe {
        aravis_sys::arv_interface_update_device_list(interface);
        aravis_sys::arv_interface_get_n_devices(interface)
    };
    (0..count)
        .map(|i| ListedDevice {
            id: text(aravis_sys::arv_interface_get_device_id, i),
            vendor: text(aravis_sys::arv_interface_get_device_vendor, i),
            model: text(aravis_sys::arv_interface_get_device_model, i),
            serial: text(aravis_sys::arv_interface_get_device_serial_nbr, i),
            address: text(aravis_sys::arv_interface_get_device_address, i),
            protocol: text(aravis_sys::arv_interface_get_device_protocol, i),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_page_of_a_buffer_is_written_to() {
        let payload_bytes = 3 * 4096 + 17;
        let buffer = touched_buffer(payload_bytes);
        let (bytes, received) = buffer.data();
        assert!(!bytes.is_null() && received == 0);
        for at in [0, 4096, 8192, 12288] {
            // SAFETY: within the buffer, which was written to there.
            assert_eq!(unsafe { *bytes.add(at) }, 0);
        }
    }
}
