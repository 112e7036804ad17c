//! The arguments of `s2mia serve`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

use super::ServerTlsArguments;

/// `s2mia serve`
#[derive(Args, Debug)]
pub(crate) struct ServeArguments {
    /// Run folder.
    pub(crate) run: PathBuf,
    /// Address for whoever acts by the policies.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:50052")]
    pub(crate) listen: SocketAddr,
    /// Take up newer checkpoints of the run as they are written; each episode keeps the one that it began with.
    #[arg(long)]
    pub(crate) follow: bool,
    /// Listen beyond this machine although nothing is encrypted and nobody is asked who they are.
    #[arg(long, conflicts_with = "tls_certificate")]
    pub(crate) insecure_allow_remote: bool,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ServerTlsArguments,
}
