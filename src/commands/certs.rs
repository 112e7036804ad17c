//! `s2mia certs`: writes a new certificate authority and a certificate for each role.

use std::fs::{self, DirBuilder};
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

/// File of the authority's certificate.
const AUTHORITY: &str = "ca.pem";
/// Name of the learner's files.
const SERVER: &str = "server";

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
    let is_new = !folder.exists();
    make_empty(folder)?;
    if let Err(error) = write_all(folder, &issuer, &server) {
        discard(folder);
        if is_new {
            // What was not removed stays, and the folder with it.
            let _removed = fs::remove_dir(folder);
        }
        return Err(error);
    }
    output::line(instructions(folder));
    Ok(())
}

fn write_all(folder: &Path, issuer: &Issuer, server: &Issued) -> anyhow::Result<()> {
    durable::replace(&folder.join(AUTHORITY), issuer.certificate().as_bytes())?;
    write_pair(folder, SERVER, server)?;
    for role in Role::ALL {
        write_pair(folder, role.name(), &issuer.client(&[role])?)?;
    }
    Ok(())
}

/// Removes the files of a call that failed, as on a full disk, because the next call needs an empty folder.
fn discard(folder: &Path) {
    let pairs = Role::ALL.map(Role::name).into_iter().chain([SERVER]);
    let files = pairs.flat_map(|name| [format!("{name}.pem"), format!("{name}.key")]);
    for file in files.chain([AUTHORITY.to_owned()]) {
        // A file that was not written cannot be removed.
        let _removed = fs::remove_file(folder.join(file));
    }
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
    fn a_call_that_fails_after_some_files_leaves_none() {
        let folder = tempfile::tempdir().unwrap();
        let issuer = Issuer::new(SystemTime::now(), YEAR).unwrap();
        let server = issuer.server(&["localhost".to_owned()]).unwrap();
        // A file cannot replace a folder.
        let obstacle = folder.path().join("operator.key");
        fs::create_dir(&obstacle).unwrap();
        assert!(write_all(folder.path(), &issuer, &server).is_err());
        let count = || folder.path().read_dir().unwrap().count();
        assert!(count() > 1);
        discard(folder.path());
        assert!(obstacle.is_dir() && count() == 1);
    }

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
