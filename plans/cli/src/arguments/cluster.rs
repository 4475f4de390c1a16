//! Arguments of `scheduler` and `executor`.

use clap::Args;

/// Where a scheduler listens, and executors look for it.
const SCHEDULER: &str = "127.0.0.1:50050";

/// Arguments of `scheduler`.
#[derive(Debug, Args)]
pub struct SchedulerArgs {
    /// Host and port to listen on, by the name or address that the others reach it by.
    #[arg(long, value_name = "HOST:PORT", default_value = SCHEDULER, value_parser = address)]
    pub bind: (String, u16),
}

/// Arguments of `executor`.
#[derive(Debug, Args)]
pub struct ExecutorArgs {
    /// The scheduler.
    #[arg(long, value_name = "HOST:PORT", default_value = SCHEDULER, value_parser = address)]
    pub scheduler: (String, u16),
    /// Give up when no scheduler answers within so many seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
    pub wait_s: u64,
    /// Host and port to listen on, by the name or address that the others reach it by.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:50051", value_parser = address)]
    pub bind: (String, u16),
    /// Units to run side by side [default: one a core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub jobs: Option<u32>,
}

fn address(text: &str) -> Result<(String, u16), String> {
    let bare = text
        .split_once("://")
        .map_or(text, |(_, rest)| rest)
        .trim_end_matches('/');
    let expected = || format!("expected host:port, found {text}");
    let (host, port) = bare.rsplit_once(':').ok_or_else(expected)?;
    let port: u16 = port.parse().map_err(|_| expected())?;
    if host.is_empty() || port == 0 {
        Err(expected())
    } else {
        Ok((host.to_owned(), port))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_a_host_and_any_port_that_there_is() {
        for (text, port) in [
            ("df://lot:50050/", 50_050),
            ("lot:1", 1),
            ("lot:65535", 65_535),
        ] {
            assert_eq!(address(text), Ok(("lot".to_owned(), port)));
        }
        for text in ["lot", "lot:0", "lot:65536", ":50050", "lot:port"] {
            assert_eq!(
                address(text),
                Err(format!("expected host:port, found {text}"))
            );
        }
    }
}
