//! An S3 server (moto, from the Python environment that `make test` sets up), and a proxy in front of it that delays,
//! refuses and loses requests and answers.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

/// Serves until its standard input ends, as it does when the tests end, however they do.
const SERVE: &str = "
import logging, sys
from moto.server import ThreadedMotoServer
logging.getLogger('werkzeug').setLevel(logging.ERROR)
server = ThreadedMotoServer('127.0.0.1', 0, verbose=False)
server.start()
print(server.get_host_and_port()[1], flush=True)
sys.stdin.read()
";

/// The server that all tests share, and what keeps it alive; `None` without the Python environment.
fn server() -> Option<SocketAddr> {
    static SERVER: OnceLock<Option<(SocketAddr, Child)>> = OnceLock::new();
    let start = || {
        let mut server = Command::new(evermap_tests::python()?)
            .args(["-c", SERVE])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut port = String::new();
        let said = server.stdout.as_mut().unwrap();
        BufReader::new(said).read_line(&mut port).unwrap();
        let port: u16 = port.trim().parse().expect("the server says its port");
        Some((SocketAddr::from(([127, 0, 0, 1], port)), server))
    };
    SERVER
        .get_or_init(start)
        .as_ref()
        .map(|(address, _)| *address)
}

/// What becomes of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    Answered,
    /// It is answered later.
    Late(Duration),
    /// 503, and the server knows nothing of it.
    Refused,
    /// The connection ends, and the server knows nothing of it.
    Lost,
    /// The server does it, and the connection ends without an answer.
    Unanswered,
    /// The connection ends in the middle of the answer.
    Torn,
}

/// A request as the proxy sees it.
#[derive(Debug, Clone)]
pub struct Request {
    head: String,
    body: Vec<u8>,
}

impl Request {
    fn read(stream: &mut impl BufRead) -> Option<Self> {
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            if stream.read_line(&mut head).ok()? == 0 {
                return None;
            }
        }
        let mut request = Self {
            head,
            body: Vec::new(),
        };
        let length = request.header("content-length");
        let length = length.map_or(0, |length| length.parse().expect("a length is a number"));
        request.body.resize(length, 0);
        stream.read_exact(&mut request.body).ok()?;
        Some(request)
    }

    fn header(&self, name: &str) -> Option<&str> {
        let lines = self.head.lines().skip(1);
        let mut headers = lines.filter_map(|line| line.split_once(": "));
        let found = headers.find(|(found, _)| found.eq_ignore_ascii_case(name));
        found.map(|(_, value)| value)
    }

    /// Whether something is written to a name that holds this.
    pub fn puts(&self, name: &str) -> bool {
        let mut words = self.head.split_whitespace();
        let line = (words.next(), words.next());
        matches!(line, (Some("PUT"), Some(path)) if path.contains(name))
    }

    /// Whether it is only for a name that nothing has.
    pub fn creates(&self) -> bool {
        self.header("if-none-match") == Some("*")
    }

    /// The server's answer, whole.
    fn forwarded(&self, server: SocketAddr) -> Vec<u8> {
        let head = self.head.lines().filter(|line| {
            let name = line.split(':').next().unwrap_or_default();
            !name.is_empty() && !name.eq_ignore_ascii_case("connection")
        });
        let head: String = head.map(|line| format!("{line}\r\n")).collect();
        let mut stream = TcpStream::connect(server).unwrap();
        let head = format!("{head}Connection: close\r\n\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        stream.write_all(&self.body).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        answer
    }
}

type Fates = dyn Fn(&Request) -> Fate + Send + Sync;

/// A bucket behind a proxy.
pub struct Bucket {
    name: String,
    proxy: SocketAddr,
    /// Requests that created something, and how many of them found that it was there.
    created: Arc<[AtomicUsize; 2]>,
}

impl Bucket {
    /// A bucket of its own, whose requests meet these fates; `None` without a server.
    pub fn new(
        name: &str,
        fates: impl Fn(&Request) -> Fate + Send + Sync + 'static,
    ) -> Option<Self> {
        let server = server()?;
        let made = Request {
            head: format!("PUT /{name} HTTP/1.1\r\nHost: s3\r\nContent-Length: 0\r\n\r\n"),
            body: Vec::new(),
        };
        let made = String::from_utf8(made.forwarded(server)).unwrap();
        assert!(made.starts_with("HTTP/1.1 200"), "{made}");
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let bucket = Self {
            name: name.to_owned(),
            proxy: listener.local_addr().unwrap(),
            created: Arc::default(),
        };
        let proxy = Arc::new(Proxy {
            server,
            fates: Box::new(fates),
            created: Arc::clone(&bucket.created),
            creating: Mutex::new(()),
        });
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let proxy = Arc::clone(&proxy);
                std::thread::spawn(move || proxy.serve(stream.unwrap()));
            }
        });
        Some(bucket)
    }

    /// Puts a file there, past the proxy.
    pub fn put(&self, name: &str, body: Vec<u8>) {
        put(&self.name, name, body);
    }

    /// The URL of a name in it.
    pub fn url(&self, name: &str) -> String {
        format!("s3://{}/{name}", self.name)
    }

    /// What a program needs to know to reach it.
    pub fn environment(&self) -> [(&'static str, String); 5] {
        [
            ("AWS_ENDPOINT_URL", format!("http://{}", self.proxy)),
            ("AWS_ALLOW_HTTP", "true".to_owned()),
            ("AWS_ACCESS_KEY_ID", "tester".to_owned()),
            ("AWS_SECRET_ACCESS_KEY", "secret".to_owned()),
            ("AWS_REGION", "us-east-1".to_owned()),
        ]
    }

    /// Requests that asked for a name that nothing has, and how many of them were told that something has it.
    pub fn created(&self) -> [usize; 2] {
        [0, 1].map(|index| self.created[index].load(Ordering::Relaxed))
    }
}

/// Nobody may put a file in the place of another without a name; the server looks at no signature.
const SIGNED: &str = "Authorization: AWS4-HMAC-SHA256 Credential=tester/20260101/us-east-1/s3/aws4_request, \
                      SignedHeaders=host, Signature=0";

/// Puts a file into a bucket, past its proxy.
pub fn put(bucket: &str, name: &str, body: Vec<u8>) {
    let head = format!(
        "PUT /{bucket}/{name} HTTP/1.1\r\nHost: s3\r\n{SIGNED}\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    let put = Request { head, body }.forwarded(server().unwrap());
    let said = String::from_utf8_lossy(&put);
    assert!(said.starts_with("HTTP/1.1 200"), "{said}");
}

struct Proxy {
    server: SocketAddr,
    fates: Box<Fates>,
    created: Arc<[AtomicUsize; 2]>,
    /// The server looks for a name and takes it in two steps; a store that keeps its word does so in one.
    creating: Mutex<()>,
}

impl Proxy {
    /// Serves one request.
    fn serve(&self, mut stream: TcpStream) {
        let Some(request) = Request::read(&mut BufReader::new(&stream)) else {
            return;
        };
        let fate = (self.fates)(&request);
        let answer = match fate {
            Fate::Lost => Vec::new(),
            Fate::Refused => {
                b"HTTP/1.1 503 Slow Down\r\nContent-Length: 0\r\nConnection: close\r\n\r\n".to_vec()
            }
            _ => self.answered(&request),
        };
        let told = match fate {
            Fate::Unanswered => 0,
            Fate::Torn => answer.len() / 2,
            _ => answer.len(),
        };
        if let Fate::Late(by) = fate {
            std::thread::sleep(by);
        }
        // Who asked may have been killed.
        let _ = stream.write_all(&answer[..told]);
        let _ = stream.shutdown(Shutdown::Both);
    }

    fn answered(&self, request: &Request) -> Vec<u8> {
        if !request.creates() {
            return request.forwarded(self.server);
        }
        let answer = {
            let _one = self.creating.lock().unwrap();
            request.forwarded(self.server)
        };
        self.created[0].fetch_add(1, Ordering::Relaxed);
        if answer.starts_with(b"HTTP/1.1 412") {
            self.created[1].fetch_add(1, Ordering::Relaxed);
        }
        answer
    }
}
