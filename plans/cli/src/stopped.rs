//! When the person, or the system, asks the program to stop.

use tokio::signal::unix::{SignalKind, signal};

/// Ends when somebody asks: by an interrupt, by asking to terminate, by closing the terminal.
pub async fn stopped() {
    tokio::select! {
        () = heard(SignalKind::interrupt()) => {}
        () = terminated() => {}
    }
}

/// As [`stopped`], but not by an interrupt.
pub async fn terminated() {
    tokio::select! {
        () = heard(SignalKind::terminate()) => {}
        () = heard(SignalKind::hangup()), if hangups_end() => {}
    }
}

/// Has what writes beyond the limit of file sizes (`ulimit -f`) be told that the file is too large: the system would end the
/// program there, in the middle of a file. Once somebody listens, it never does.
pub fn live_with_limits() {
    let kind = SignalKind::from_raw(rustix::process::Signal::XFSZ.as_raw());
    if let Err(error) = signal(kind) {
        tracing::warn!(%error, ?kind, "a signal is not heard");
    }
}

/// Ends with the first signal of a kind; never where the system lets nobody listen.
async fn heard(kind: SignalKind) {
    match signal(kind) {
        Ok(mut signals) => {
            signals.recv().await;
        }
        Err(error) => {
            tracing::warn!(%error, ?kind, "a signal is not heard");
            std::future::pending().await
        }
    }
}

/// Whether a hangup ends this program, which is not so under `nohup`. Who listens changes that, so it is asked before;
/// where the system does not tell, hangups do what they did.
fn hangups_end() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let hangup = 1_u64 << (SignalKind::hangup().as_raw_value() - 1);
    ignored(&status).is_some_and(|signals| signals & hangup == 0)
}

/// The signals that a process ignores, a bit each from signal 1 on, by its status as Linux writes it.
fn ignored(status: &str) -> Option<u64> {
    let mut lines = status.lines();
    let mask = lines.find_map(|line| line.strip_prefix("SigIgn:"))?;
    u64::from_str_radix(mask.trim(), 16).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_process_ignores_is_read_of_its_status() {
        let status = |mask: &str| format!("Name:\tevermap\nSigBlk:\t0001\nSigIgn:\t{mask}\n");
        assert_eq!(ignored(&status("0000000000001001")), Some(0x1001));
        assert_eq!(ignored(&status("0000000000000000")), Some(0));
        assert_eq!(ignored(&status("none")), None);
        assert_eq!(ignored("Name:\tevermap\n"), None);
    }
}
