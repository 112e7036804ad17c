//! Authentication and authorisation with real processes: certificates of another authority, of the wrong role or
//! expired, plain text to a TLS port and the reverse. Each is rejected with one line on either
//! side, and the run continues.

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use crate::commands::Background;
use crate::learners::{Learner, inspect};
use proto::wire::learner_service_client::LearnerServiceClient;
use proto::wire::policy_service_client::PolicyServiceClient;
use proto::wire::{DescribePolicyRequest, DescribeRunRequest};
use security::Role;
use security::development::{Issued, Issuer};
use tonic::Code;
use tonic::transport::{Certificate, ClientTlsConfig, Endpoint, Identity};

fn s2mia(arguments: &[&str]) -> (i32, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_s2mia")).args(arguments).output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code().unwrap(), String::from_utf8(text).unwrap())
}

/// A folder of files created by `s2mia certs`.
struct Certificates(PathBuf);

impl Certificates {
    fn make(folder: PathBuf) -> Self {
        let (code, text) = s2mia(&["certs", folder.to_str().unwrap()]);
        assert_eq!(code, 0, "{text}");
        Self(folder)
    }

    fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }

    fn of_learner(&self) -> Vec<String> {
        let files = [
            ("--tls-certificate", "server.pem"),
            ("--tls-key", "server.key"),
            ("--tls-client-ca", "ca.pem"),
        ];
        files.iter().flat_map(|(flag, name)| [(*flag).to_owned(), self.file(name)]).collect()
    }

    /// Options of a client that trusts `learners` and presents this folder's certificate for `role`.
    fn of_client(&self, learners: &Self, role: &str) -> Vec<String> {
        let (certificate, key) = (format!("{role}.pem"), format!("{role}.key"));
        let files = [
            ("--tls-ca", learners.file("ca.pem")),
            ("--tls-certificate", self.file(&certificate)),
            ("--tls-key", self.file(&key)),
        ];
        files.into_iter().flat_map(|(flag, path)| [flag.to_owned(), path]).collect()
    }
}

fn actor(url: &str, tls: &[String]) -> (i32, String) {
    let more = tls.iter().map(String::as_str);
    s2mia(
        &["actor", "--max-outage-secs", "20", "--learner", url]
            .into_iter()
            .chain(more)
            .collect::<Vec<_>>(),
    )
}

/// Checks that an actor exits at once with one line that contains `words`.
fn refused(url: &str, tls: &[String], words: &str) {
    let (code, text) = actor(url, tls);
    assert_ne!(code, 0, "{text}");
    assert!(text.contains(words) && text.lines().count() == 1, "{words}: {text}");
}

#[test]
fn a_run_over_tls_ends_in_the_same_state_in_spite_of_rejected_peers() {
    let folder = tempfile::tempdir().unwrap();
    let (own, other) = (folder.path().join("own"), folder.path().join("other"));
    let (own, other) = (Certificates::make(own), Certificates::make(other));
    let (guarded, open) = (folder.path().join("guarded"), folder.path().join("open"));
    let mut learner = Learner::start(&guarded, &own.of_learner());
    let mut plain = Learner::start(&open, &[]);
    assert!(learner.url.starts_with("https://") && plain.url.starts_with("http://"));
    let actors = own.of_client(&own, "actor");

    let elsewhere = [actors.clone(), vec!["--tls-server-name".into(), "elsewhere".into()]].concat();
    refused(&learner.url, &own.of_client(&other, "actor"), "given with --tls-ca has not signed it");
    refused(&learner.url, &other.of_client(&own, "actor"), "another authority has signed it");
    refused(&learner.url, &elsewhere, "elsewhere");
    refused(&learner.url, &own.of_client(&own, "operator"), "needs the role actor");
    refused(&learner.url.replace("https", "http"), &[], "requires TLS; use https://");
    refused(&plain.url.replace("http", "https"), &actors, "use an http:// URL");
    let unguarded = learner.url.replace("https", "http");
    for question in [&["status", unguarded.as_str()][..], &["health", "--learner", &unguarded]] {
        let (_, text) = s2mia(question);
        assert!(text.contains("requires TLS") && text.contains("pass --tls-ca"), "{text}");
    }

    let text = learner.finish(&actors);
    for words in [
        "received fatal alert",
        "invalid peer certificate",
        "needs the role actor; the certificate carries operator",
        "speaks plain text, but this learner requires TLS",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let text = plain.finish(&[]);
    assert!(text.contains("speaks TLS, but this learner serves plain text"), "{text}");
    assert_eq!(inspect(&guarded), inspect(&open));
}

/// Runs `s2mia`; returns its exit status and its one line of output.
fn asked(question: &[&str], tls: &[String]) -> (i32, String) {
    let more = tls.iter().map(String::as_str);
    let (code, text) = s2mia(&question.iter().copied().chain(more).collect::<Vec<_>>());
    assert!(code == 0 || text.lines().count() == 1, "{text}");
    (code, text)
}

#[test]
fn over_tls_the_role_in_the_certificate_determines_the_allowed_calls() {
    let folder = tempfile::tempdir().unwrap();
    let own = Certificates::make(folder.path().join("own"));
    let other = Certificates::make(folder.path().join("other"));
    let run = folder.path().join("run");
    let mut learner = Learner::start(&run, &own.of_learner());
    let (url, run) = (learner.url.clone(), run.to_str().unwrap());
    let plain = url.replace("https", "http");
    let (status, health) = (["status", &url], ["health", "--learner", &url]);
    let of = |role| own.of_client(&own, role);
    let (no_files, strangers) = (Vec::new(), other.of_client(&own, "operator"));
    let needs_certificates = "needs --tls-ca, --tls-certificate and --tls-key";
    let stop = ["stop", url.as_str()];
    let needs_operator = "needs the role operator; the certificate carries actor";
    let cases: [(&[&str], &[String], i32, &str); 11] = [
        (&stop, &of("actor"), 1, needs_operator),
        (&["watch", &url], &of("actor"), 1, needs_operator),
        (&status, &of("actor"), 1, needs_operator),
        (&status, &of("operator"), 0, "iteration 0"),
        (&["status", run], &of("operator"), 0, "iteration 0"),
        (&health, &of("actor"), 0, "serves"),
        (&health, &strangers, 1, "does not answer"),
        (&status, &no_files, 2, needs_certificates),
        (&health, &no_files, 2, needs_certificates),
        (&["status", &plain], &of("operator"), 2, "begins with https://"),
        (&stop, &of("operator"), 0, "stops after a checkpoint"),
    ];
    for (question, tls, code, words) in cases {
        let text = asked(question, tls);
        assert!(text.0 == code && text.1.contains(words), "{question:?}: {text:?}");
    }
    learner.wait();
}

/// Calls the learner with a certificate that the client does not check itself.
async fn call(url: &str, authority: &Path, own: Option<Issued>) -> Result<(), tonic::Status> {
    let authority = std::fs::read(authority).unwrap();
    let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(authority));
    let tls = match own {
        Some(own) => tls.identity(Identity::from_pem(own.certificate, own.key)),
        None => tls,
    };
    let channel = Endpoint::from_shared(url.to_owned()).unwrap().tls_config(tls).unwrap();
    let channel =
        channel.connect().await.map_err(|error| tonic::Status::unavailable(error.to_string()))?;
    LearnerServiceClient::new(channel).describe_run(DescribeRunRequest {}).await.map(drop)
}

#[tokio::test]
async fn missing_expired_and_roleless_certificates_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let own = Certificates::make(folder.path().join("own"));
    let (day, now) = (Duration::from_secs(86_400), SystemTime::now());
    let (old, new) = (Issuer::new(now - 2 * day, day), Issuer::new(now, day));
    let (old, new) = (old.unwrap(), new.unwrap());
    let both = [old.certificate(), new.certificate()].concat();
    // The first authority in the file must be valid itself.
    std::fs::write(own.file("clients.pem"), [new.certificate(), both].concat()).unwrap();
    let mut files = own.of_learner();
    *files.last_mut().unwrap() = own.file("clients.pem");
    let mut learner = Learner::start(&folder.path().join("run"), &files);
    let authority = PathBuf::from(own.file("ca.pem"));

    assert!(call(&learner.url, &authority, None).await.is_err());
    let expired = old.client(&[Role::Actor]).unwrap();
    assert!(call(&learner.url, &authority, Some(expired)).await.is_err());
    let without_role = new.client(&[]).unwrap();
    let status = call(&learner.url, &authority, Some(without_role)).await.unwrap_err();
    assert_eq!(status.code(), Code::PermissionDenied, "{status:?}");
    call(&learner.url, &authority, Some(new.client(&[Role::Actor]).unwrap())).await.unwrap();

    let text = tokio::task::spawn_blocking(move || learner.stop()).await.unwrap();
    for words in
        ["peer sent no certificates", "certificate expired", "the certificate carries no role"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[tokio::test]
async fn policies_are_served_over_tls_to_operators() {
    let folder = tempfile::tempdir().unwrap();
    let (own, run) = (Certificates::make(folder.path().join("own")), folder.path().join("run"));
    let mut learner = Learner::start(&run, &[]);
    learner.stop();
    let tls = own.of_learner();
    let tls = tls.iter().map(String::as_str).collect::<Vec<_>>();
    let own_arguments = ["serve", run.to_str().unwrap(), "--listen=127.0.0.1:0"];
    let mut server = Background::start(&[&own_arguments, tls.as_slice()].concat());
    let url = server.url();
    assert!(url.starts_with("https://"));
    for (role, may) in [("operator", true), ("actor", false)] {
        let read = |name: String| std::fs::read(own.file(&name)).unwrap();
        let identity = Identity::from_pem(read(format!("{role}.pem")), read(format!("{role}.key")));
        let authority = Certificate::from_pem(read("ca.pem".to_owned()));
        let tls = ClientTlsConfig::new().ca_certificate(authority).identity(identity);
        let channel = Endpoint::from_shared(url.clone()).unwrap().tls_config(tls).unwrap();
        let mut client = PolicyServiceClient::new(channel.connect().await.unwrap());
        let text = client.describe_policy(DescribePolicyRequest {}).await;
        let denied = text.as_ref().is_err_and(|status| status.code() == Code::PermissionDenied);
        assert!(text.is_ok() == may && denied != may, "{role}: {text:?}");
    }
}

#[test]
fn keys_are_readable_by_their_owner_only_and_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let own = Certificates::make(folder.path().join("own"));
    for name in ["server.key", "actor.key", "operator.key"] {
        let mode = std::fs::metadata(own.file(name)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{name}");
    }
    let before = std::fs::read(own.file("actor.key")).unwrap();
    let (code, text) = s2mia(&["certs", own.0.to_str().unwrap()]);
    assert_eq!(code, 2);
    assert!(text.contains("nothing is overwritten") && text.lines().count() == 1, "{text}");
    assert_eq!(std::fs::read(own.file("actor.key")).unwrap(), before);
}

#[test]
fn an_invalid_file_is_reported_in_one_line_with_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let own = Certificates::make(folder.path().join("own"));
    let long_ago = SystemTime::UNIX_EPOCH + Duration::from_secs(86_400);
    let issuer = Issuer::new(long_ago, Duration::from_secs(86_400)).unwrap();
    let expired = issuer.client(&[Role::Actor]).unwrap();
    std::fs::write(own.file("old.pem"), &expired.certificate).unwrap();
    std::fs::write(own.file("old.key"), &expired.key).unwrap();
    for (certificate, key, words) in [
        ("none.pem", "actor.key", "cannot read"),
        ("actor.key", "actor.key", "holds no certificate in PEM form"),
        ("actor.pem", "operator.key", "does not fit the certificate"),
        ("old.pem", "old.key", "expired at 1970-01-03 00:00:00 UTC"),
    ] {
        let (authority, certificate, key) =
            (own.file("ca.pem"), own.file(certificate), own.file(key));
        let files = ["--tls-certificate", &certificate, "--tls-key", &key];
        let learner = [&["learner", "--tls-client-ca", &authority], files.as_slice()].concat();
        let url = ["actor", "--learner", "https://127.0.0.1:1", "--tls-ca", &authority];
        for arguments in [learner, [url.as_slice(), &files].concat()] {
            let (code, text) = s2mia(&arguments);
            assert_eq!(code, 2, "{text}");
            assert!(text.contains(words) && text.lines().count() == 1, "{words}: {text}");
        }
    }
}

#[test]
fn output_and_files_of_a_run_contain_no_secret() {
    let folder = tempfile::tempdir().unwrap();
    let own = Certificates::make(folder.path().join("own"));
    let run = folder.path().join("run");
    let mut learner =
        Learner::start(&run, &[own.of_learner(), vec!["--log=trace".into()]].concat());
    let (code, actor) =
        actor(&learner.url, &[own.of_client(&own, "actor"), vec!["--log=trace".into()]].concat());
    assert_eq!(code, 0, "{actor}");
    let mut texts = vec![actor, learner.wait()];
    texts.extend(
        files_in(&run)
            .iter()
            .map(|file| String::from_utf8_lossy(&std::fs::read(file).unwrap()).into_owned()),
    );
    assert!(texts.len() > 5);
    for name in ["server.key", "actor.key"] {
        let key = std::fs::read_to_string(own.file(name)).unwrap();
        let secrets = key.lines().filter(|line| !line.starts_with("-----")).collect::<Vec<_>>();
        assert!(!secrets.is_empty());
        for secret in secrets {
            assert!(texts.iter().all(|text| !text.contains(secret)), "{name}");
        }
    }
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = folder.read_dir().unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files_in(&path) } else { vec![path] }).collect()
}
