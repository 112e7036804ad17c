//! Where a run's page is shown, and to whom.

use std::net::SocketAddr;
use std::str::FromStr;

use clap::Args;

/// How `train` and `learner` show their run.
#[derive(Args, Clone, Debug)]
pub(crate) struct PageArguments {
    /// Address of the run's page and of its figures for Prometheus (/metrics); off: none.
    #[arg(long, value_name = "ADDRESS | off", default_value = "127.0.0.1:0")]
    pub(crate) page: PageAddress,
    /// More names and addresses by which the page may be asked for, besides those of loopback.
    #[arg(long, value_name = "HOST,...", value_delimiter = ',')]
    pub(crate) page_host: Vec<String>,
    /// Show the page beyond this machine although nothing is encrypted and nobody is asked who they are.
    #[arg(long)]
    pub(crate) insecure_allow_remote_page: bool,
}

/// Where the page is, if anywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PageAddress {
    /// Nowhere.
    Off,
    /// Here; port 0 is any free one.
    At(SocketAddr),
}

impl FromStr for PageAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "off" {
            return Ok(Self::Off);
        }
        let address = text.parse().map(Self::At);
        address.map_err(|_| {
            "allowed are off and an address with a port, such as 127.0.0.1:8080".to_owned()
        })
    }
}
