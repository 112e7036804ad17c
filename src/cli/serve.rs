//! The arguments of `s2mia serve`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

use super::ServerTlsArguments;

/// `s2mia serve`
#[derive(Args, Debug)]
pub(crate) struct ServeArguments {
    /// Run folder, or one of its checkpoints.
    pub(crate) run: PathBuf,
    /// Address on which the server listens for clients of the policies.
    #[arg(
        long,
        value_name = "ADDRESS",
        default_value = "127.0.0.1:50052",
        value_parser = crate::listening::address
    )]
    pub(crate) listen: SocketAddr,
    /// Load newer checkpoints of the run as they are written. An episode keeps the checkpoint that it started with.
    #[arg(long)]
    pub(crate) follow: bool,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ServerTlsArguments,
}
