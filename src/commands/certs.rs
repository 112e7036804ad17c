//! `s2mia certs`: writes a new certificate authority and a certificate for each role.

use std::fs::DirBuilder;
use std::net::IpAddr;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::Context as _;
use clap::Args;
use learner::store::durable;
use security::Role;
use security::development::{Issued, Issuer};

use crate::errors::Usage;
use crate::process::{output, shell};

/// `s2mia certs`
#[derive(Args, Debug)]
pub(crate) struct CertsArguments {
    /// New or empty folder for the certificates and keys.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
    /// Host names and addresses that actors use to reach the learner.
    #[arg(
        long,
        value_name = "HOST,...",
        value_delimiter = ',',
        value_parser = host,
        default_value = "localhost,127.0.0.1,::1"
    )]
    pub(crate) names: Vec<String>,
}

/// Parses a host name or address, for clap.
fn host(text: &str) -> Result<String, String> {
    let is_part = |letter: char| letter.is_ascii_alphanumeric() || "-._*".contains(letter);
    let is_name = !text.is_empty() && text.chars().all(is_part);
    if is_name || text.parse::<IpAddr>().is_ok() {
        return Ok(text.to_owned());
    }
    Err("must be host names or addresses without a port".to_owned())
}

/// Only the owner may list the folder.
const PRIVATE_FOLDER: u32 = 0o700;

/// Validity of all certificates.
const YEAR: Duration = Duration::from_secs(365 * 86_400);

/// Writes all files into a new or empty folder and prints how to use them.
pub(super) fn run(arguments: &CertsArguments) -> anyhow::Result<()> {
    let folder = &arguments.folder;
    let issuer = Issuer::new(SystemTime::now(), YEAR)?;
    let server = issuer
        .server(&arguments.names)
        .map_err(|error| Usage::new(format!("--names {}: {error}", arguments.names.join(","))))?;
    make_empty(folder)?;
    durable::replace(&folder.join("ca.pem"), issuer.certificate().as_bytes())?;
    write_pair(folder, "server", &server)?;
    for role in Role::ALL {
        write_pair(folder, role.name(), &issuer.client(&[role])?)?;
    }
    output::line(instructions(folder));
    Ok(())
}

fn make_empty(folder: &Path) -> anyhow::Result<()> {
    let shown = folder.display();
    if folder.exists() {
        let entries = folder.read_dir().with_context(|| format!("cannot read {shown}"))?;
        if entries.count() > 0 {
            let why = format!("{shown} is not empty; nothing is overwritten, name a new folder");
            return Err(Usage::new(why).into());
        }
        return Ok(());
    }
    let mut builder = DirBuilder::new();
    builder.recursive(true).mode(PRIVATE_FOLDER);
    builder.create(folder).with_context(|| format!("cannot make {shown}"))
}

fn write_pair(folder: &Path, name: &str, issued: &Issued) -> anyhow::Result<()> {
    durable::replace(&folder.join(format!("{name}.pem")), issued.certificate.as_bytes())?;
    Ok(durable::replace_private(&folder.join(format!("{name}.key")), issued.key.as_bytes())?)
}

fn instructions(folder: &Path) -> String {
    let file = |name: &str| shell::path(&folder.join(name));
    let [ca, server, server_key] = ["ca.pem", "server.pem", "server.key"].map(file);
    let [actor, actor_key] = ["actor.pem", "actor.key"].map(file);
    format!(
        "{} holds an authority, a learner's certificate and one for each role, valid for a year.\nThe authority's own key \
         is not stored: to add a certificate, create all again.\n\n  s2mia learner --listen 0.0.0.0:50051 \
         --tls-certificate {server} --tls-key {server_key} --tls-client-ca {ca}\n  s2mia actor --learner \
         https://HOST:50051 --tls-ca {ca} --tls-certificate {actor} --tls-key {actor_key}",
        folder.display()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_is_for_host_names_and_addresses() {
        for name in ["localhost", "*.example.org", "gpu_7", "10.0.0.5", "::1"] {
            assert_eq!(host(name), Ok(name.to_owned()));
        }
        for text in ["", "a b", "https://learner", "learner:5", "[::1]"] {
            assert!(host(text).is_err(), "{text}");
        }
    }
}
