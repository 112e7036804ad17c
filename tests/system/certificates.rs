//! Authentication and authorisation with real processes: certificates of another authority, of the wrong role or
//! expired, plain text to a TLS port and the reverse. Each is rejected with one line on either
//! side, and the run continues.

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use crate::processes::{Background, Learner};
use crate::runs::{
    Runs, SHORT, command, failure, inspect, outcome, refused, s2mia, succeeded, text, under, words,
};
use proto::wire::learner_service_client::LearnerServiceClient;
use proto::wire::policy_service_client::PolicyServiceClient;
use proto::wire::{DescribePolicyRequest, DescribeRunRequest};
use security::Role;
use security::development::{Issued, Issuer};
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Code, Status};

const DAY: Duration = Duration::from_secs(86_400);

/// A folder of files as `s2mia certs` makes them.
pub(crate) struct Certificates(pub(crate) PathBuf);

impl Certificates {
    pub(crate) fn make(folder: PathBuf) -> Self {
        succeeded(&["certs", text(&folder)]);
        Self(folder)
    }

    fn file(&self, name: &str) -> String {
        text(&self.0.join(name)).to_owned()
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.0.join(name)).unwrap()
    }

    pub(crate) fn write(&self, name: &str, issued: &Issued) {
        std::fs::write(self.file(&format!("{name}.key")), &issued.key).unwrap();
        std::fs::write(self.file(&format!("{name}.pem")), &issued.certificate).unwrap();
    }

    /// Options of a process that presents the certificate `name`, and its option with the file of trusted authorities.
    fn options(&self, name: &str, authorities: [String; 2]) -> Vec<String> {
        let own = ["--tls-certificate".into(), self.file(&format!("{name}.pem"))];
        let key = ["--tls-key".into(), self.file(&format!("{name}.key"))];
        [authorities, own, key].concat()
    }

    pub(crate) fn of_learner(&self) -> Vec<String> {
        self.options("server", ["--tls-client-ca".into(), self.file("ca.pem")])
    }

    /// Options of a client that trusts `learners` and presents this folder's certificate for `role`.
    pub(crate) fn of_client(&self, learners: &Self, role: &str) -> Vec<String> {
        self.options(role, ["--tls-ca".into(), learners.file("ca.pem")])
    }
}

/// Starts the learner of a short run with these options.
fn learner(folder: &Path, tls: &[String]) -> Learner {
    Learner::start(folder, &[&SHORT, &words(tls)[..]].concat())
}

/// Exit status and output of a question with TLS options.
fn asked(question: &[&str], tls: &[String]) -> (Option<i32>, String) {
    outcome(s2mia(&[question, &words(tls)[..]].concat()))
}

fn act(url: &str, tls: &[String]) -> (Option<i32>, String) {
    asked(&["actor", "--max-outage-secs", "20", "--learner", url], tls)
}

#[test]
fn a_run_over_tls_ends_in_the_same_state_in_spite_of_rejected_peers() {
    let runs = Runs::new();
    let own = Certificates::make(runs.folder("own"));
    let other = Certificates::make(runs.folder("other"));
    let (guarded, open) = (runs.folder("guarded"), runs.folder("open"));
    let mut learner = learner(&guarded, &own.of_learner());
    let mut plain = Learner::start(&open, &SHORT);
    assert!(learner.url.starts_with("https://") && plain.url.starts_with("http://"));
    let actors = own.of_client(&own, "actor");
    let elsewhere = [actors.clone(), vec!["--tls-server-name".into(), "elsewhere".into()]].concat();
    let unguarded = learner.url.replace("https", "http");
    for (url, tls, words) in [
        (&learner.url, own.of_client(&other, "actor"), "given with --tls-ca has not signed it"),
        (&learner.url, other.of_client(&own, "actor"), "another authority has signed it"),
        (&learner.url, elsewhere, "elsewhere"),
        (&learner.url, own.of_client(&own, "operator"), "needs the role actor"),
        (&unguarded, Vec::new(), "requires TLS; use https://"),
        (&plain.url.replace("http", "https"), actors.clone(), "use an http:// URL"),
    ] {
        let (code, text) = act(url, &tls);
        assert_ne!(code, Some(0), "{text}");
        assert!(text.contains(words) && text.lines().count() == 1, "{words}: {text}");
    }
    let health = ["health", "--learner", &unguarded];
    for question in [&["status", &unguarded][..], &health, &["watch", &unguarded]] {
        let (code, text) = asked(question, &[]);
        assert!(code == Some(1) && text.lines().count() == 1, "{text}");
        assert!(text.contains("requires TLS; use https:// with --tls-ca"), "{text}");
    }

    let text = learner.finish(&words(&actors));
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

#[test]
fn over_tls_the_role_in_the_certificate_determines_the_allowed_calls() {
    let runs = Runs::new();
    let own = Certificates::make(runs.folder("own"));
    let other = Certificates::make(runs.folder("other"));
    let run = runs.folder("run");
    let mut learner = learner(&run, &own.of_learner());
    let url = learner.url.clone();
    let plain = url.replace("https", "http");
    let (stop, status, health) = (["stop", &url], ["status", &url], ["health", "--learner", &url]);
    let of = |role| own.of_client(&own, role);
    let (no_files, strangers) = (Vec::new(), other.of_client(&own, "operator"));
    let needs_certificates = "needs --tls-ca, --tls-certificate and --tls-key";
    let needs_operator = "needs the role operator; the certificate carries actor";
    let cases: [(&[&str], &[String], i32, &str); 14] = [
        (&stop, &of("actor"), 1, needs_operator),
        (&["watch", &url], &of("actor"), 1, needs_operator),
        (&status, &of("actor"), 1, needs_operator),
        (&status, &of("operator"), 0, "iteration 0"),
        (&["status", text(&run)], &of("operator"), 0, "iteration 0"),
        (&health, &of("actor"), 0, "serves"),
        (&health, &strangers, 1, "another authority has signed it"),
        (&status, &strangers, 1, "another authority has signed it"),
        (&["watch", &url], &strangers, 1, "another authority has signed it"),
        (&["watch", &url], &own.of_client(&other, "operator"), 1, "--tls-ca has not signed it"),
        (&status, &no_files, 2, needs_certificates),
        (&health, &no_files, 2, needs_certificates),
        (&["status", &plain], &of("operator"), 2, "begins with https://"),
        (&stop, &of("operator"), 0, "stops after a checkpoint"),
    ];
    for (question, tls, code, words) in cases {
        let (found, text) = asked(question, tls);
        assert!(found == Some(code) && text.contains(words), "{question:?}: {text}");
        assert!(code == 0 || text.lines().count() == 1, "{text}");
    }
    learner.process.rest();
}

/// A connection with a certificate that the client does not check itself.
async fn connected(url: &str, authority: Vec<u8>, own: Option<Issued>) -> Result<Channel, Status> {
    let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(authority));
    let tls = match own {
        Some(own) => tls.identity(Identity::from_pem(own.certificate, own.key)),
        None => tls,
    };
    let channel = Endpoint::from_shared(url.to_owned()).unwrap().tls_config(tls).unwrap();
    channel.connect().await.map_err(|error| Status::unavailable(error.to_string()))
}

#[tokio::test]
async fn missing_expired_and_roleless_certificates_are_rejected() {
    let runs = Runs::new();
    let own = Certificates::make(runs.folder("own"));
    let now = SystemTime::now();
    let old = Issuer::new(now - 2 * DAY, DAY).unwrap();
    let new = Issuer::new(now, DAY).unwrap();
    // The first authority in the file must be valid itself.
    let authorities = [new.certificate(), old.certificate()].concat();
    std::fs::write(own.file("clients.pem"), authorities).unwrap();
    let files = own.options("server", ["--tls-client-ca".into(), own.file("clients.pem")]);
    let mut learner = learner(&runs.folder("run"), &files);
    let url = learner.url.clone();
    let call = async |certificate| {
        let channel = connected(&url, own.read("ca.pem"), certificate).await?;
        LearnerServiceClient::new(channel).describe_run(DescribeRunRequest {}).await.map(drop)
    };
    assert!(call(None).await.is_err());
    assert!(call(Some(old.client(&[Role::Actor]).unwrap())).await.is_err());
    let status = call(Some(new.client(&[]).unwrap())).await.unwrap_err();
    assert_eq!(status.code(), Code::PermissionDenied, "{status:?}");
    call(Some(new.client(&[Role::Actor]).unwrap())).await.unwrap();

    let text = tokio::task::spawn_blocking(move || learner.process.stop()).await.unwrap();
    for words in
        ["peer sent no certificates", "certificate expired", "the certificate carries no role"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[tokio::test]
async fn policies_are_served_over_tls_to_operators() {
    let runs = Runs::new();
    let own = Certificates::make(runs.folder("own"));
    let run = runs.folder("run");
    Learner::start(&run, &SHORT).process.stop();
    let tls = own.of_learner();
    let mut serve = command(&["serve", text(&run), "--listen=127.0.0.1:0"]);
    let mut server = Background::start(serve.args(&tls));
    let url = server.url();
    assert!(url.starts_with("https://"));
    for (role, may) in [("operator", true), ("actor", false)] {
        let certificate = String::from_utf8(own.read(&format!("{role}.pem"))).unwrap();
        let key = String::from_utf8(own.read(&format!("{role}.key"))).unwrap();
        let issued = Issued { certificate, key };
        let channel = connected(&url, own.read("ca.pem"), Some(issued)).await.unwrap();
        let mut client = PolicyServiceClient::new(channel);
        let text = client.describe_policy(DescribePolicyRequest {}).await;
        let denied = text.as_ref().is_err_and(|status| status.code() == Code::PermissionDenied);
        assert!(text.is_ok() == may && denied != may, "{role}: {text:?}");
    }
}

#[test]
fn keys_are_readable_by_their_owner_only_and_never_overwritten() {
    let runs = Runs::new();
    let own = Certificates::make(runs.folder("own"));
    for name in ["server.key", "actor.key", "operator.key"] {
        let mode = std::fs::metadata(own.file(name)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{name}");
    }
    let before = own.read("actor.key");
    assert!(refused(&["certs", text(&own.0)]).contains("nothing is overwritten"));
    assert_eq!(own.read("actor.key"), before);
}

#[test]
fn a_disk_without_space_leaves_no_folder_of_certificates() {
    let runs = Runs::new();
    let folder = runs.folder("own");
    // No file may have a byte.
    let limited = ["-c", "ulimit -f 0; exec \"$0\" \"$@\""];
    let line = failure(&mut under("sh", &limited, &command(&["certs", text(&folder)])), 1);
    assert!(line.contains("ca.pem"), "{line}");
    assert!(!folder.exists());
    Certificates::make(folder);
}

#[test]
fn an_invalid_file_is_reported_in_one_line_with_its_name() {
    let runs = Runs::new();
    let own = Certificates::make(runs.folder("own"));
    let issuer = Issuer::new(SystemTime::UNIX_EPOCH + DAY, DAY).unwrap();
    own.write("old", &issuer.client(&[Role::Actor]).unwrap());
    let authority = own.file("ca.pem");
    let learner = ["learner", "--tls-client-ca", &authority];
    let actor = ["actor", "--learner", "https://127.0.0.1:1", "--tls-ca", &authority];
    for (role, own_name, other_name, not_for) in [
        (&learner[..], "server", "actor", "is not for server authentication"),
        (&actor[..], "actor", "server", "is not for client authentication"),
    ] {
        // Some clients accept a server's own authority, whose key is not known here.
        let of_authority = if own_name == "actor" {
            "is that of an authority"
        } else {
            "does not fit the certificate"
        };
        let pem = |name: &str| own.file(&format!("{name}.pem"));
        let key = |name: &str| own.file(&format!("{name}.key"));
        for (certificate, key, words) in [
            (pem("none"), key(own_name), "cannot read"),
            (key(own_name), key(own_name), "holds no certificate in PEM form"),
            (pem(own_name), key("operator"), "does not fit the certificate"),
            (pem("old"), key("old"), "expired at 1970-01-03 00:00:00 UTC"),
            (pem(other_name), key(other_name), not_for),
            (pem("ca"), key(own_name), of_authority),
        ] {
            let files = ["--tls-certificate", &certificate, "--tls-key", &key];
            let line = refused(&[role, &files].concat());
            assert!(line.contains(words), "{words}: {line}");
        }
    }
    let operators = own.file("operator.pem");
    let (certificate, key) = (own.file("server.pem"), own.file("server.key"));
    let files = ["--tls-certificate", &certificate, "--tls-key", &key];
    let line = refused(&[&["learner", "--tls-client-ca", &operators][..], &files].concat());
    assert!(line.contains("operator.pem holds a certificate that is no authority"), "{line}");
}

#[test]
fn output_and_files_of_a_run_contain_no_secret() {
    let runs = Runs::new();
    let own = Certificates::make(runs.folder("own"));
    let run = runs.folder("run");
    let traced = |tls: Vec<String>| [tls, vec!["--log=trace".into()]].concat();
    let mut learner = learner(&run, &traced(own.of_learner()));
    let (code, actor) = act(&learner.url, &traced(own.of_client(&own, "actor")));
    assert_eq!(code, Some(0), "{actor}");
    learner.process.rest();
    let mut texts = vec![actor, learner.process.log()];
    let read = |file: &PathBuf| String::from_utf8_lossy(&std::fs::read(file).unwrap()).into_owned();
    texts.extend(files_in(&run).iter().map(read));
    assert!(texts.len() > 5);
    for name in ["server.key", "actor.key"] {
        let key = String::from_utf8(own.read(name)).unwrap();
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
