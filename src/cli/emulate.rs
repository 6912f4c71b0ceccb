//! `pitchd emulate`: a GigE Vision camera in software.

use std::io::BufRead;
use std::net::Ipv4Addr;
use std::time::{Duration, Instant, SystemTime};

use std::path::Path;

use anyhow::{Context, bail};

use crate::emulation::{
    Drill, Emulator, EmulatorOptions, Faults, Handing, Idle, Script, ScriptShape, pattern, repeated,
    session_script,
};
use crate::scene::{CameraId, PixelFormat};

/// Serve frames as a real GigE Vision camera on the network.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example: a camera that any GigE Vision program can open (127.0.0.x needs no privileges):
  pitchd emulate pattern:2048x1024 --camera first --address 127.0.0.5 &
  arv-tool-0.8 -a 127.0.0.5 control DeviceSerialNumber

Two cameras of a recording that begin together in five seconds:
  for i in 1 2; do pitchd emulate session --camera cam$i --address 127.0.0.$i --start-at $(($(date +%s)+5)) & done

One that sends twelve bits a pixel:
  pitchd emulate session --camera first --address 127.0.0.5 --pixel-format Mono12p

Commands on standard input, one a line: freeze S, disconnect S, reboot S, clock S (step the device clock),
faults KEY=VALUE,…, loss P, reorder_ms MS, jitter_ms MS, quit. Faults: loss, reorder, reorder_ms, jitter_ms,
clock_offset_s, skew_ppm, ptp_apart_s (clock of a PTP network of its own); mangle (share of stream packets that are
spoilt), mangling (how: any, noise, cut, long, number, block, kind, status, leader, shape, payload, trailer, bits),
mangle_control (share of answers).")]
pub struct EmulateArgs {
    /// What the camera sees: a session folder, or `pattern:WIDTHxHEIGHT`.
    pub source: String,
    /// Id of the camera; also its user-defined name.
    #[arg(long)]
    pub camera: String,
    /// Address to serve on; UDP port 3956 must be free there.
    #[arg(long)]
    pub address: Ipv4Addr,
    /// Serial number [default: made from the camera's id].
    #[arg(long)]
    pub serial: Option<String>,
    /// Frames a second of a pattern.
    #[arg(long, default_value_t = 175.0)]
    pub rate: f64,
    /// Pixel formats that it has, as in `Mono8,Mono12p`; the first is the one at the start. The source's levels are the
    /// upper eight bits.
    #[arg(long, value_delimiter = ',', default_value = "Mono8", value_parser = pixel_format)]
    pub pixel_format: Vec<PixelFormat>,
    /// Faults from the start, as in `loss=0.01,skew_ppm=50,clock_offset_s=1000`.
    #[arg(long, default_value = "")]
    pub faults: String,
    /// Speed of the link that is stood in for, Gb/s; 0: as fast as it goes.
    #[arg(long, default_value_t = 5.0)]
    pub link_gbps: f64,
    /// Unix time at which the source begins, so that several cameras begin together [default: with the first acquisition].
    #[arg(long)]
    pub start_at: Option<f64>,
    /// Show a session again every so many seconds, longer than it lasts; all of its frames are kept in memory.
    #[arg(long, value_name = "S")]
    pub every: Option<f64>,
    /// Before the source begins, between its clips and after its end: what the camera shows.
    #[arg(long, value_enum, default_value_t = Between::Still)]
    pub between: Between,
    /// Frames of a session to read into memory beforehand, GiB.
    #[arg(long, default_value_t = 2.0)]
    pub preload_gib: f64,
    /// Hand packets to the system one by one: for programs that receive through a packet socket (as root, most do).
    #[arg(long)]
    pub plain_packets: bool,
    /// Seed of the faults.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// As [`Idle`], as it is typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Between {
    /// A still image at the camera's rate.
    Still,
    /// Nothing, as a triggered camera.
    Silent,
}

const GIB: f64 = 1_073_741_824.0;

/// Runs until `quit` on standard input or a signal.
pub fn run(args: &EmulateArgs) -> anyhow::Result<()> {
    let camera = CameraId::new(&args.camera)?;
    let (shape, script) = open(args, &camera)?;
    let faults = Faults::default().changed_by(&args.faults).context("--faults")?;
    let serial = args.serial.clone().unwrap_or_else(|| format!("EMU-{camera}"));
    let options = EmulatorOptions {
        user_name: camera.to_string(),
        faults,
        link_gbps: args.link_gbps,
        begin: args.start_at.map(instant_of),
        between: match args.between {
            Between::Still => Idle::Still,
            Between::Silent => Idle::Silent,
        },
        pixel_formats: args.pixel_format.clone(),
        handing: if args.plain_packets {
            Handing::OneByOne
        } else {
            Handing::Offloaded
        },
        seed: args.seed,
        ..EmulatorOptions::new(args.address, &serial)
    };
    let emulator = Emulator::start(&options, shape, script)?;
    say_line!(
        "camera {camera}: {}x{} {}, {} Hz, serial {serial}, at {}",
        shape.width_px,
        shape.height_px,
        names(&args.pixel_format, " or "),
        shape.rate_hz,
        args.address
    );
    obey_standard_input(&emulator);
    // Standard input is closed: serve on until a signal ends the program.
    while !emulator.is_stopped() {
        std::thread::sleep(Duration::from_millis(200));
    }
    let counters = emulator.counters();
    say_line!(
        "{} frames, {} skipped, {} packets, {} lost, {} resent",
        counters.frames,
        counters.skipped,
        counters.packets,
        counters.lost,
        counters.resent
    );
    Ok(())
}

fn obey_standard_input(emulator: &Emulator) {
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        if line.trim() == "stats" {
            say_line!("{:?}", emulator.counters());
            continue;
        }
        match Drill::parse(&line, emulator.faults()) {
            Ok(drill) => emulator.drill(drill),
            Err(error) => tell_line!("pitchd: {error}"),
        }
        if emulator.is_stopped() {
            return;
        }
    }
}

fn open(args: &EmulateArgs, camera: &CameraId) -> anyhow::Result<(ScriptShape, Script)> {
    let Some(size) = args.source.strip_prefix("pattern:") else {
        let (shape, mut script) = session_script(Path::new(&args.source), camera)?;
        if let Some(every_s) = args.every {
            let frames: Vec<_> = script.collect();
            let lasts_s = frames.last().map_or(0.0, |f| 1e-9 * f.begin_ns as f64);
            let every = Duration::try_from_secs_f64(every_s)
                .ok()
                .filter(|_| every_s > lasts_s)
                .with_context(|| format!("--every {every_s}: the session lasts {lasts_s:.1} s"))?;
            return Ok((shape, repeated(frames, every)));
        }
        // A slow disk must not look like a slow camera: what fits is in memory before the camera answers.
        let most = (args.preload_gib * GIB) as usize / shape.bytes().max(1);
        let ready: Vec<_> = script.by_ref().take(most).collect();
        return Ok((shape, Box::new(ready.into_iter().chain(script))));
    };
    let numbers = size
        .split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let (width_px, height_px) = numbers
        .filter(|(w, h)| (8..=8192).contains(w) && (8..=8192).contains(h))
        .with_context(|| format!("{}: use pattern:WIDTHxHEIGHT, each 8 to 8192", args.source))?;
    if !(1.0..=1000.0).contains(&args.rate) {
        bail!("--rate {}: 1 to 1000 Hz", args.rate);
    }
    let shape = ScriptShape {
        width_px,
        height_px,
        rate_hz: args.rate,
        exposure_s: 0.001,
    };
    Ok((shape, pattern(shape)))
}

fn names(formats: &[PixelFormat], between: &str) -> String {
    let names: Vec<_> = formats.iter().map(|format| format.name()).collect();
    names.join(between)
}

fn pixel_format(text: &str) -> Result<PixelFormat, String> {
    let unknown = || format!("the known ones are {}", names(&PixelFormat::ALL, ", "));
    PixelFormat::of_name(text).ok_or_else(unknown)
}

/// The instant of a Unix time; in the past too: a camera that is switched on late shows what is on now.
fn instant_of(unix_s: f64) -> Instant {
    let now_s = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .map_or(0.0, |d| d.as_secs_f64());
    let (now, ahead_s) = (Instant::now(), unix_s - now_s);
    let away = Duration::try_from_secs_f64(ahead_s.abs()).unwrap_or_default();
    if ahead_s >= 0.0 {
        now + away
    } else {
        now.checked_sub(away).unwrap_or(now)
    }
}
