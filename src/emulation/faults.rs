//! What goes wrong on purpose: faults from the start (`--faults loss=0.01,skew_ppm=50`) and on command (`freeze 3`).

use std::time::Duration;

use super::mangle::Mangling;

/// Faults that hold until changed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Faults {
    /// Share of packets that are never sent (resent ones may be lost again).
    pub loss: f64,
    /// Share of packet groups that are held back by [`Self::reorder_ms`].
    pub reorder: f64,
    /// Delay of a held group, milliseconds.
    pub reorder_ms: f64,
    /// Mean of the exponential delay of a frame's departure, milliseconds.
    pub jitter_ms: f64,
    /// Device clock at the start, seconds.
    pub clock_offset_s: f64,
    /// Device clock over the host's, parts per million; positive: fast.
    pub skew_ppm: f64,
    /// Network clock (PTP) that the camera follows over the one of this host's other cameras, seconds.
    pub ptp_apart_s: f64,
    /// Share of stream packets that are spoilt.
    pub mangle: f64,
    /// In which way.
    pub mangling: Mangling,
    /// Share of answers on the control channel that are spoilt.
    pub mangle_control: f64,
}

/// Something to do now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drill {
    /// No frames, but control still answers.
    Freeze(Duration),
    /// Neither frames nor answers, as with the cable pulled; the camera stays up.
    Disconnect(Duration),
    /// Power cycle: silent for this long, then registers, clock and frame numbers start anew.
    Reboot(Duration),
    /// Sets the device clock forward (or back) by seconds.
    StepClock(f64),
    /// Other lasting faults from now on.
    Faults(Faults),
    /// Ends the emulator.
    Quit,
}

/// A fault or drill that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?}: {1}")]
pub struct FaultError(pub String, pub &'static str);

const KEYS: &str = "use loss, reorder, reorder_ms, jitter_ms, clock_offset_s, skew_ppm, ptp_apart_s, mangle, mangling, \
                    mangle_control, as in loss=0.01,skew_ppm=50";
const MANGLINGS: &str =
    "use any, noise, cut, long, number, block, kind, status, leader, shape, payload, trailer or bits";
const WORDS: &str = "use freeze S, disconnect S, reboot S, clock S, faults KEY=VALUE,…, loss P, reorder_ms MS, jitter_ms MS or quit";

impl Faults {
    /// Changes these faults by `key=value` pairs separated by commas.
    ///
    /// # Errors
    /// An unknown key or a value out of range, with the pair.
    pub fn changed_by(mut self, text: &str) -> Result<Self, FaultError> {
        for pair in text.split(',').map(str::trim).filter(|p| !p.is_empty()) {
            let fault = |why| FaultError(pair.to_owned(), why);
            let (key, value) = pair.split_once('=').ok_or_else(|| fault(KEYS))?;
            if key.trim() == "mangling" {
                self.mangling = Mangling::named(value.trim()).ok_or_else(|| fault(MANGLINGS))?;
                continue;
            }
            let value: f64 = value
                .trim()
                .parse()
                .map_err(|_| fault("the value is no number"))?;
            let (slot, (least, most)) = match key.trim() {
                "loss" => (&mut self.loss, (0.0, 1.0)),
                "reorder" => (&mut self.reorder, (0.0, 1.0)),
                "reorder_ms" => (&mut self.reorder_ms, (0.0, 1000.0)),
                "jitter_ms" => (&mut self.jitter_ms, (0.0, 1000.0)),
                "clock_offset_s" => (&mut self.clock_offset_s, (0.0, 4e9)),
                "skew_ppm" => (&mut self.skew_ppm, (-1000.0, 1000.0)),
                "ptp_apart_s" => (&mut self.ptp_apart_s, (-1e6, 1e6)),
                "mangle" => (&mut self.mangle, (0.0, 1.0)),
                "mangle_control" => (&mut self.mangle_control, (0.0, 1.0)),
                _ => return Err(fault(KEYS)),
            };
            if !(least..=most).contains(&value) {
                return Err(fault("the value is out of range"));
            }
            *slot = value;
        }
        if self.reorder_ms > 0.0 && self.reorder == 0.0 {
            self.reorder = 0.01;
        }
        Ok(self)
    }
}

impl Drill {
    /// Reads one command line; `faults` are those that hold now.
    ///
    /// # Errors
    /// What is not understood, and what would be.
    pub fn parse(line: &str, faults: Faults) -> Result<Self, FaultError> {
        let fault = |why| FaultError(line.trim().to_owned(), why);
        let mut words = line.split_whitespace();
        let word = words.next().unwrap_or_default();
        let argument = words.next();
        let number = || -> Result<f64, FaultError> {
            let value = argument.and_then(|a| a.parse::<f64>().ok());
            value.filter(|v| v.is_finite()).ok_or_else(|| fault(WORDS))
        };
        let seconds = || {
            number()
                .and_then(|s| Duration::try_from_secs_f64(s).map_err(|_| fault("seconds must be positive")))
        };
        Ok(match word {
            "freeze" => Self::Freeze(seconds()?),
            "disconnect" => Self::Disconnect(seconds()?),
            "reboot" => Self::Reboot(seconds()?),
            "clock" => Self::StepClock(number()?),
            "faults" => Self::Faults(faults.changed_by(argument.unwrap_or_default())?),
            "loss" | "reorder_ms" | "jitter_ms" => {
                Self::Faults(faults.changed_by(&format!("{word}={}", number()?))?)
            }
            "quit" => Self::Quit,
            _ => return Err(fault(WORDS)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_and_drills_are_read_or_refused_with_reason() {
        let faults = Faults::default().changed_by("loss=0.01, skew_ppm=-50").unwrap();
        assert_eq!((faults.loss, faults.skew_ppm), (0.01, -50.0));
        assert_eq!(faults.changed_by("reorder_ms=5").unwrap().reorder, 0.01);
        let hostile = faults.changed_by("mangle=0.5,mangling=leader").unwrap();
        assert_eq!((hostile.mangle, hostile.mangling), (0.5, Mangling::Leader));
        for wrong in ["loss", "loss=2", "los=0.1", "loss=x", "mangling=all"] {
            assert!(faults.changed_by(wrong).is_err(), "{wrong}");
        }
        assert_eq!(
            Drill::parse("freeze 3", faults),
            Ok(Drill::Freeze(Duration::from_secs(3)))
        );
        assert_eq!(Drill::parse("clock -2.5", faults), Ok(Drill::StepClock(-2.5)));
        assert_eq!(
            Drill::parse("loss 0.5", faults),
            Ok(Drill::Faults(Faults { loss: 0.5, ..faults }))
        );
        for wrong in ["", "freeze", "freeze -1", "explode 3", "loss nan", "reboot inf"] {
            assert!(Drill::parse(wrong, faults).is_err(), "{wrong}");
        }
    }
}
