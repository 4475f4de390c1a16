//! Who may come in, and by which door.
//!
//! Without a file of users a server listens on loopback alone, and believes who is on this machine. With it every
//! request needs a name and password or a token, and beyond loopback TLS as well. Who guesses at these waits for all
//! others who do.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use evermap_schemas::Fault;
use pgwire::api::auth::sasl::scram::{SCRAM_ITERATIONS, gen_salted_password};
use pgwire::api::auth::{AuthSource, LoginInfo, Password};
use pgwire::error::PgWireResult;
use serde::Deserialize;
use tokio::sync::Mutex;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

use crate::arguments::ServeArgs;

/// Who may come in; everybody on this machine where no users are named.
#[derive(Clone)]
pub struct Access {
    users: Option<Arc<Users>>,
    /// What makes connections private.
    tls: Option<Arc<ServerConfig>>,
    /// Held by who is told that a secret is wrong.
    wrong: Arc<Mutex<()>>,
}

/// The users of a file. Passwords are kept salted, tokens as digests.
#[derive(Debug)]
pub struct Users {
    /// Of this process; passwords that nobody has are made with it.
    key: [u8; 32],
    salt: Vec<u8>,
    salted: BTreeMap<String, Vec<u8>>,
    /// Digests of tokens, and of `name:password`, each with how it is said, and the user's name.
    secrets: Vec<(blake3::Hash, String)>,
}

/// Who asks: a user's name; `None` for somebody on this machine where no users are named.
#[derive(Debug, Clone)]
pub struct Who(pub Option<String>);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct UsersFile {
    users: Vec<User>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct User {
    name: String,
    #[serde(default)]
    password: Option<String>,
    #[serde(default)]
    token: Option<String>,
}

/// Letters of a token or password at least.
const SHORTEST_SECRET: usize = 8;

/// How long it takes to be told that a secret is wrong.
const WRONG: Duration = Duration::from_millis(50);

/// How a token is said in HTTP, and how a name with its password.
const BEARER: &str = "bearer";
const BASIC: &str = "basic";

impl Access {
    /// Who may come in, as the command line says.
    ///
    /// # Errors
    /// A user fault for files that make no sense, or for a door that would stand open: an address beyond loopback
    /// without users and TLS.
    pub fn new(args: &ServeArgs) -> Result<Self, Fault> {
        let users = args.users.as_deref().map(Users::read).transpose()?;
        let tls = match (&args.certificate, &args.key) {
            (Some(certificate), Some(key)) => Some(Arc::new(private(certificate, key)?)),
            _ => None,
        };
        let access = Self {
            users: users.map(Arc::new),
            tls,
            wrong: Arc::default(),
        };
        for address in [args.http, args.postgres] {
            access.fits(address)?;
        }
        Ok(access)
    }

    fn fits(&self, address: SocketAddr) -> Result<(), Fault> {
        let missing = match (&self.users, &self.tls) {
            _ if address.ip().is_loopback() => return Ok(()),
            (Some(_), Some(_)) => return Ok(()),
            (None, Some(_)) => "--users",
            (Some(_), None) => "--certificate and --key",
            (None, None) => "--users, --certificate and --key",
        };
        Err(Fault::user(format!(
            "{address} is reached from other machines: expected {missing} beside it"
        ))
        .next("or listen on 127.0.0.1, and reach it through ssh"))
    }

    /// Who asks with these headers `Authorization` and `Host`; `None` for those who may not come in.
    pub fn lets_in(&self, authorization: Option<&str>, host: Option<&str>) -> Option<Who> {
        match &self.users {
            Some(users) => users
                .know(authorization?)
                .map(|name| Who(Some(name.to_owned()))),
            // A page of elsewhere whose name was made to lead here would read maps through a person's browser.
            None => host.is_none_or(is_this_machine).then_some(Who(None)),
        }
    }

    /// Whether nobody gets in without TLS.
    pub fn needs_tls(&self) -> bool {
        self.tls.is_some()
    }

    /// What makes connections private, where they are, of those who speak one of these protocols or do not say which: what
    /// is meant for one door is no message at another, and gRPC insists on being asked.
    pub fn tls(&self, protocols: &[&str]) -> Option<TlsAcceptor> {
        let mut config = ServerConfig::clone(self.tls.as_ref()?);
        let names = protocols.iter().map(|name| name.as_bytes().to_vec());
        config.alpn_protocols = names.collect();
        Some(TlsAcceptor::from(Arc::new(config)))
    }

    /// Waits before somebody is told that a secret is wrong, behind all others who are: so there are few guesses in a
    /// second, by however many connections. Who says a right one waits for nobody.
    pub async fn hold_up(&self) {
        let _turn = self.wrong.lock().await;
        tokio::time::sleep(WRONG).await;
    }

    /// The users; `None` where everybody on this machine may come in.
    pub fn users(&self) -> Option<Arc<Users>> {
        self.users.clone()
    }
}

/// Whether a host, with or without a port, is loopback.
pub fn is_this_machine(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|digit| digit.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name.trim_start_matches('[').trim_end_matches(']');
    name.eq_ignore_ascii_case("localhost")
        || name
            .parse()
            .is_ok_and(|address: IpAddr| address.is_loopback())
}

impl Users {
    fn read(path: &Path) -> Result<Self, Fault> {
        let place = path.display().to_string();
        let text = evermap_datasets::read_text(path)
            .map_err(|error| Fault::user(format!("cannot read it: {error}")).at(place.clone()))?;
        is_private(path).map_err(|fault| fault.at(place.clone()))?;
        Self::parse(&text).map_err(|fault| fault.at(place))
    }

    fn parse(text: &str) -> Result<Self, Fault> {
        let file: UsersFile = serde_yaml_ng::from_str(text)
            .map_err(|error| Fault::user(format!("expected a list of users, found: {error}")))?;
        let salt = uuid::Uuid::new_v4().as_bytes().to_vec();
        let key = [uuid::Uuid::new_v4(), uuid::Uuid::new_v4()];
        let key = key.map(uuid::Uuid::into_bytes).concat();
        let mut users = Self {
            key: *blake3::hash(&key).as_bytes(),
            salt,
            salted: BTreeMap::new(),
            secrets: Vec::new(),
        };
        for user in file.users {
            users.add(user)?;
        }
        match users.secrets.is_empty() {
            true => Err(Fault::user("expected at least one user, found none")),
            false => Ok(users),
        }
    }

    fn add(&mut self, user: User) -> Result<(), Fault> {
        let name = user.name;
        if name.contains(':') {
            // In HTTP, what is behind it is the password.
            return Err(Fault::user(format!(
                "expected the name of a user without `:`, found {name}"
            )));
        }
        for (what, secret) in [("password", &user.password), ("token", &user.token)] {
            if secret
                .as_ref()
                .is_some_and(|secret| secret.len() < SHORTEST_SECRET)
            {
                return Err(Fault::user(format!(
                    "expected a {what} of {SHORTEST_SECRET} letters or more for {name}, found a shorter one"
                )));
            }
        }
        if user.password.is_none() && user.token.is_none() {
            return Err(Fault::user(format!(
                "expected a password or a token for {name}, found neither"
            )));
        }
        if let Some(token) = user.token {
            self.secrets
                .push((digest(BEARER, token.as_bytes()), name.clone()));
        }
        if let Some(password) = user.password {
            let pair = format!("{name}:{password}");
            self.secrets
                .push((digest(BASIC, pair.as_bytes()), name.clone()));
            let salted = gen_salted_password(&password, &self.salt, SCRAM_ITERATIONS);
            if self.salted.insert(name.clone(), salted).is_some() {
                return Err(Fault::user(format!(
                    "expected each user once, found {name} twice"
                )));
            }
        }
        Ok(())
    }

    /// The user whose token, or name with password, an `Authorization` header has. The time that it takes does not tell
    /// how much of it is right: digests are compared, each to its end.
    fn know<'u>(&'u self, header: &str) -> Option<&'u str> {
        let (scheme, value) = header.split_once(' ')?;
        let found = match scheme.to_ascii_lowercase().as_str() {
            BEARER => digest(BEARER, value.trim().as_bytes()),
            BASIC => digest(BASIC, &STANDARD.decode(value.trim()).unwrap_or_default()),
            _ => return None,
        };
        let compared = |user, (known, name): &'u (blake3::Hash, String)| match *known == found {
            true => Some(name.as_str()),
            false => user,
        };
        self.secrets.iter().fold(None, compared)
    }
}

/// What is kept of a secret that is said in one way.
fn digest(scheme: &str, secret: &[u8]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(scheme.as_bytes()).update(b" ").update(secret);
    hasher.finalize()
}

#[async_trait]
impl AuthSource for Users {
    async fn get_password(&self, login: &LoginInfo) -> PgWireResult<Password> {
        let user = login.user().unwrap_or_default();
        // Who is no user, or has no password, learns no more than who says a wrong one.
        let nobody = || {
            let known_by_nobody = blake3::keyed_hash(&self.key, user.as_bytes());
            known_by_nobody.as_bytes().to_vec()
        };
        let salted = self.salted.get(user).cloned().unwrap_or_else(nobody);
        Ok(Password::new(Some(self.salt.clone()), salted))
    }
}

/// That nobody else can read a file.
#[cfg(unix)]
fn is_private(path: &Path) -> Result<(), Fault> {
    use std::os::unix::fs::PermissionsExt;
    let mode = path.metadata().map(|found| found.permissions().mode());
    match mode {
        Ok(mode) if mode & 0o077 != 0 => Err(Fault::user(format!(
            "expected a file that only its owner reads, found mode {:03o}",
            mode & 0o777
        ))
        .next("chmod 600 it")),
        _ => Ok(()),
    }
}

#[cfg(not(unix))]
fn is_private(_: &Path) -> Result<(), Fault> {
    Ok(())
}

fn private(certificate: &Path, key: &Path) -> Result<ServerConfig, Fault> {
    let refused = |path: &Path, error: &dyn std::fmt::Display| {
        Fault::user(format!("expected PEM, found: {error}")).at(path.display().to_string())
    };
    let chain = CertificateDer::pem_file_iter(certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| refused(certificate, &error))?;
    let secret = PrivateKeyDer::from_pem_file(key).map_err(|error| refused(key, &error))?;
    let provider = Arc::new(tokio_rustls::rustls::crypto::ring::default_provider());
    ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| Fault::bug(format!("no TLS: {error}")))?
        .with_no_client_auth()
        .with_single_cert(chain, secret)
        .map_err(|error| refused(certificate, &error))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn headers_are_known_whole_or_not_at_all() {
        let users = Users::parse(
            "users:\n- {name: ada, password: byron-1815}\n- {name: robot, token: t0ken-t0ken}\n",
        );
        let users = users.unwrap();
        let basic = |pair: &str| format!("Basic {}", STANDARD.encode(pair));
        assert_eq!(users.know(&basic("ada:byron-1815")), Some("ada"));
        assert_eq!(users.know("Bearer t0ken-t0ken"), Some("robot"));
        for wrong in [
            "Bearer t0ken",
            "Bearer ",
            "Basic ada:byron-1815",
            "t0ken-t0ken",
            &basic("ada:byron"),
            &basic("robot:t0ken-t0ken"),
            // What is right in one place opens no other.
            "Bearer byron-1815",
            "Bearer ada:byron-1815",
            &basic("t0ken-t0ken"),
        ] {
            assert_eq!(users.know(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn files_of_users_are_refused_that_let_anybody_in() {
        for (text, says) in [
            ("users: []", "at least one"),
            ("users: [{name: ada}]", "password or a token"),
            ("users: [{name: ada, password: short}]", "8 letters"),
            ("users: [{name: ada, pasword: long-enough}]", "pasword"),
            (
                "users: [{name: 'ada:byron', password: long-enough}]",
                "without `:`",
            ),
            ("ada: byron", "list of users"),
        ] {
            let fault = Users::parse(text).unwrap_err().to_string();
            assert!(fault.contains(says), "{text}: {fault}");
        }
    }

    #[tokio::test]
    async fn who_guesses_waits_for_all_others_who_do() {
        let access = Access {
            users: None,
            tls: None,
            wrong: Arc::default(),
        };
        let begun = std::time::Instant::now();
        let guesses = (0..6).map(|_| access.hold_up());
        futures::future::join_all(guesses).await;
        assert!(begun.elapsed() >= 6 * WRONG, "{:?}", begun.elapsed());
    }

    #[test]
    fn hosts_of_this_machine_are_known_by_name_and_number() {
        for host in [
            "localhost",
            "localhost:8760",
            "127.0.0.1:1",
            "[::1]:8760",
            "127.0.0.1",
        ] {
            assert!(is_this_machine(host), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8760",
            "127.0.0.1.evil.example",
            "10.0.0.1:80",
            "",
        ] {
            assert!(!is_this_machine(host), "{host}");
        }
    }
}
