//! The arguments for the web page of runs: its address, its host names and remote access.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;

/// The web page of `s2mia train` and `s2mia learner`.
#[derive(Args, Clone, Debug)]
pub(crate) struct PageArguments {
    /// Address of the run's web page and Prometheus metrics (/metrics); off disables both.
    #[arg(long, value_name = "ADDRESS | off", default_value = "127.0.0.1:0")]
    pub(crate) page: PageAddress,
    /// Additional host names and addresses accepted in requests for the page, besides loopback.
    #[arg(long, value_name = "HOST,...", value_delimiter = ',')]
    pub(crate) page_host: Vec<String>,
    /// Allow a non-loopback --page address without encryption and authentication.
    #[arg(long)]
    pub(crate) insecure_allow_remote_page: bool,
}

/// `s2mia page`
#[derive(Args, Debug)]
pub(crate) struct RunsPageArguments {
    /// Run folders, finished or growing [default: all runs in ./runs].
    #[arg(value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// Address of the page; port 0 selects a free port.
    #[arg(
        long,
        value_name = "ADDRESS",
        default_value = "127.0.0.1:0",
        value_parser = crate::listening::address
    )]
    pub(crate) listen: SocketAddr,
    /// Additional host names and addresses accepted in requests, besides loopback.
    #[arg(long, value_name = "HOST,...", value_delimiter = ',')]
    pub(crate) page_host: Vec<String>,
    /// Allow a non-loopback --listen address without encryption and authentication.
    #[arg(long)]
    pub(crate) insecure_allow_remote_page: bool,
}

/// Address of the page, if it is enabled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PageAddress {
    /// The page is disabled.
    Off,
    /// Address to listen on; port 0 selects a free port.
    At(SocketAddr),
}

impl FromStr for PageAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "off" {
            return Ok(Self::Off);
        }
        let address = crate::listening::address(text).map(Self::At);
        address.map_err(|why| {
            format!("{why}; allowed are off and an address with a port, such as 127.0.0.1:8080")
        })
    }
}
