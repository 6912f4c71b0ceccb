//! The control channel of the emulated camera: who may write, the heartbeat, and what a write sets off.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use crossbeam_channel::Sender as Channel;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::camera::{PATIENCE, Shared, lock};
use super::gvcp::{Answer, Command, Refusal, Request};
use super::mangle::spoil_answer;
use super::registers::{
    Effect, HEARTBEAT_MS, PRIVILEGE, PTP_OFFSET_NS, PTP_STATUS, RegisterBank, TIMESTAMP_HIGH,
};
use super::sender::Order;

/// The program that holds the camera.
struct Holder {
    who: SocketAddr,
    heard: Instant,
}

/// Answers control commands until the camera ends.
pub(super) fn serve(shared: &Shared, socket: &UdpSocket, orders: &Channel<Order>) {
    let mut holder: Option<Holder> = None;
    let mut random = Pcg64::seed_from_u64(u64::from(shared.source_port));
    let mut datagram = [0_u8; 2048];
    // A socket that cannot time out would never see the end.
    if socket.set_read_timeout(Some(PATIENCE)).is_err() {
        return;
    }
    while !shared.stopped() {
        let heard = socket.recv_from(&mut datagram);
        expire(shared, &mut holder, orders);
        let Ok((bytes, from)) = heard else { continue };
        if shared.is_silent() {
            continue;
        }
        let Some(command) = datagram.get(..bytes).and_then(Command::parse) else {
            continue;
        };
        let granted = handle(shared, &command, from, &mut holder, orders);
        if command.answer == Answer::Wanted {
            let mut answer = match granted {
                Ok(payload) => command.grant(&payload),
                Err(why) => command.refuse(why),
            };
            let mangle = lock(&shared.faults).mangle_control;
            if mangle > 0.0 && random.random_bool(mangle) {
                spoil_answer(&mut answer, &mut random);
            }
            if let Err(error) = socket.send_to(&answer, from) {
                tracing::debug!(%error, %from, "an answer could not be sent");
            }
        }
    }
}

/// Lets go of a camera whose program has fallen silent, or that has been power-cycled.
fn expire(shared: &Shared, holder: &mut Option<Holder>, orders: &Channel<Order>) {
    let Some(held) = holder else { return };
    let mut bank = lock(&shared.bank);
    let patience = Duration::from_millis(u64::from(bank.get32(HEARTBEAT_MS)));
    if bank.is_held() && held.heard.elapsed() <= patience {
        return;
    }
    bank.set32(PRIVILEGE, 0);
    bank.set_holder(Ipv4Addr::UNSPECIFIED, 0);
    *holder = None;
    let _ = orders.send(Order::Stop);
}

fn handle(
    shared: &Shared,
    command: &Command,
    from: SocketAddr,
    holder: &mut Option<Holder>,
    orders: &Channel<Order>,
) -> Result<Vec<u8>, Refusal> {
    if let Some(held) = holder.as_mut().filter(|h| h.who == from) {
        held.heard = Instant::now();
    }
    let holds = holder.as_ref().is_some_and(|h| h.who == from);
    let mut bank = lock(&shared.bank);
    match &command.request {
        Request::Discovery => Ok(bank.discovery()),
        Request::ReadRegisters(addresses) => {
            let mut values = Vec::with_capacity(4 * addresses.len());
            for address in addresses {
                values.extend(bank.read(*address, 4)?);
            }
            Ok(values)
        }
        Request::ReadMemory { address, count } => {
            let mut answer = address.to_be_bytes().to_vec();
            answer.extend(bank.read(*address, *count)?);
            Ok(answer)
        }
        Request::WriteRegisters(writes) => {
            let mut done: u16 = 0;
            for (address, value) in writes {
                if *address == PRIVILEGE {
                    claim(&mut bank, holder, from, *value)?;
                } else if holds {
                    let effect = bank.write32(*address, *value)?;
                    act(shared, &mut bank, effect, orders);
                } else {
                    return Err(Refusal::AccessDenied);
                }
                done += 1;
            }
            Ok([0_u16.to_be_bytes(), done.to_be_bytes()].concat())
        }
        Request::WriteMemory { address, bytes } => {
            if !holds {
                return Err(Refusal::AccessDenied);
            }
            let effect = bank.write_memory(*address, bytes)?;
            act(shared, &mut bank, effect, orders);
            let count = u16::try_from(bytes.len()).unwrap_or(u16::MAX);
            Ok([0_u16.to_be_bytes(), count.to_be_bytes()].concat())
        }
        Request::PacketResend { block, first, last } => {
            // Receivers ask from the socket on which they receive: the same host, another port.
            if holder.as_ref().is_some_and(|h| h.who.ip() == from.ip()) {
                let _ = orders.send(Order::Resend(*block, *first, *last));
            }
            Ok(Vec::new())
        }
        Request::Unknown => Err(Refusal::NotImplemented),
        Request::Malformed => Err(Refusal::InvalidParameter),
    }
}

/// Takes or gives up the privilege of control.
fn claim(
    bank: &mut RegisterBank,
    holder: &mut Option<Holder>,
    from: SocketAddr,
    value: u32,
) -> Result<(), Refusal> {
    if holder.as_ref().is_some_and(|h| h.who != from) {
        return Err(Refusal::AccessDenied);
    }
    bank.write32(PRIVILEGE, value)?;
    *holder = bank.is_held().then(|| Holder {
        who: from,
        heard: Instant::now(),
    });
    match (from, bank.is_held()) {
        (SocketAddr::V4(host), true) => bank.set_holder(*host.ip(), host.port()),
        _ => bank.set_holder(Ipv4Addr::UNSPECIFIED, 0),
    }
    Ok(())
}

fn act(shared: &Shared, bank: &mut RegisterBank, effect: Effect, orders: &Channel<Order>) {
    let order = match effect {
        Effect::None => return,
        Effect::Start => Order::Start(bank.stream_settings()),
        Effect::Stop => Order::Stop,
        Effect::TestPacket => Order::TestPacket(bank.stream_settings()),
        Effect::LatchTimestamp => {
            let ticks = lock(&shared.clock).ticks(Instant::now());
            bank.set32(TIMESTAMP_HIGH, (ticks >> 32) as u32);
            bank.set32(TIMESTAMP_HIGH + 4, ticks as u32);
            return;
        }
        Effect::ResetTimestamp => {
            shared.reset_clock();
            return;
        }
        Effect::FollowPtp(follow) => {
            let apart_s = lock(&shared.faults).ptp_apart_s;
            lock(&shared.clock).follow(Instant::now(), follow.then_some(apart_s));
            return;
        }
        Effect::LatchPtp => {
            let (state, offset_ns) = lock(&shared.clock).ptp_state(Instant::now());
            bank.set32(PTP_STATUS, state as u32);
            bank.set32(PTP_OFFSET_NS, offset_ns);
            return;
        }
        Effect::Reboot => {
            shared.reset_clock();
            bank.set32(PRIVILEGE, 0);
            Order::Stop
        }
    };
    let _ = orders.send(order);
}

/// Answers broadcast discovery from the camera's own address until the camera ends.
pub(super) fn answer_discovery(shared: &Shared, broadcast: &UdpSocket, answering: &UdpSocket) {
    let mut datagram = [0_u8; 2048];
    if broadcast.set_read_timeout(Some(PATIENCE)).is_err() {
        return;
    }
    while !shared.stopped() {
        let Ok((bytes, from)) = broadcast.recv_from(&mut datagram) else {
            continue;
        };
        let command = datagram.get(..bytes).and_then(Command::parse);
        let Some(command) = command.filter(|c| c.request == Request::Discovery && !shared.is_silent()) else {
            continue;
        };
        let answer = command.grant(&lock(&shared.bank).discovery());
        if let Err(error) = answering.send_to(&answer, from) {
            tracing::debug!(%error, %from, "a discovery answer could not be sent");
        }
    }
}
