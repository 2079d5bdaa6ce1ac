//! A temporary folder, and the program run in it.

use std::collections::BTreeMap;
use std::fs::File;
#[cfg(unix)]
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
#[cfg(unix)]
use std::time::{Duration, Instant};

/// How long a test waits for the program to reach a state before it fails.
#[cfg(unix)]
const PATIENCE: Duration = Duration::from_mins(5);

/// A safetensors file with this text as its only tensor.
pub(crate) fn safetensors(text: &str) -> String {
    let size = text.len();
    let header = format!(r#"{{"w":{{"dtype":"U8","shape":[{size}],"data_offsets":[0,{size}]}}}}"#);
    let length = (header.len() as u64).to_le_bytes().map(char::from);
    // The length of such a short header is one ASCII character.
    length.into_iter().collect::<String>() + &header + text
}

/// A temporary folder to run the program in.
pub(crate) struct Folder(tempfile::TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, text).unwrap();
        path
    }

    /// Contents of all files in a subfolder, by their path in it.
    pub(crate) fn files(&self, name: &str) -> BTreeMap<String, Vec<u8>> {
        let (root, mut found) = (self.path(name), BTreeMap::new());
        let mut folders = vec![root.clone()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let below = path.strip_prefix(&root).unwrap().display().to_string();
                    found.insert(below, std::fs::read(&path).unwrap());
                }
            }
        }
        found
    }

    /// `flowservo` with these arguments, separated by spaces.
    fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_flowservo"));
        command.args(arguments.split_whitespace()).current_dir(self.0.path());
        command
    }

    /// Runs `flowservo` with these arguments, separated by spaces.
    pub(crate) fn run(&self, arguments: &str) -> Run {
        Run { arguments: arguments.to_owned(), output: self.command(arguments).output().unwrap() }
    }

    /// Runs the program with standard output, and optionally standard error, connected to a pipe without a reader.
    pub(crate) fn run_unread(&self, arguments: &str, also_errors: bool) -> Run {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let errors = if also_errors { writer.try_clone().unwrap().into() } else { Stdio::piped() };
        let output = self.command(arguments).stdout(writer).stderr(errors).output().unwrap();
        Run { arguments: arguments.to_owned(), output }
    }

    /// Runs the program with only these Vulkan drivers, given by their manifest files, and without OpenGL.
    #[cfg(feature = "wgpu-software")]
    pub(crate) fn run_with_driver(&self, driver: &str, arguments: &str) -> Run {
        let mut program = self.command(arguments);
        program.env("VK_DRIVER_FILES", driver).env("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent.json");
        // Disables a Mesa layer that prints a warning when there is no windowing system.
        let output = program.env("NODEVICE_SELECT", "1").output().unwrap();
        Run { arguments: arguments.to_owned(), output }
    }

    /// Runs the program with a limit on the size of each file, in 512-byte blocks. A write beyond the limit fails, as on a
    /// full disk.
    #[cfg(unix)]
    pub(crate) fn run_with_little_space(&self, blocks: u32, arguments: &str) -> Run {
        self.run_limited("trap '' XFSZ", blocks, arguments)
    }

    /// Runs the program and has the system kill it, without a chance to clean up, when it writes a file beyond this size, in
    /// 512-byte blocks. Returns false if it finishes without such a write.
    #[cfg(unix)]
    pub(crate) fn run_and_kill_at_size(&self, blocks: u32, arguments: &str) -> bool {
        self.run_limited("ulimit -c 0", blocks, arguments).output.status.code().is_none()
    }

    #[cfg(unix)]
    fn run_limited(&self, setup: &str, blocks: u32, arguments: &str) -> Run {
        let program = env!("CARGO_BIN_EXE_flowservo");
        // Where `sh` is Bash, POSIX mode makes the unit of `ulimit -f` 512 bytes instead of 1024.
        let script = format!("{setup}; ulimit -f {blocks}; exec {program} {arguments}");
        let mut shell = Command::new("sh");
        shell.env("POSIXLY_CORRECT", "1").arg("-c").arg(script).current_dir(self.0.path());
        Run { arguments: arguments.to_owned(), output: shell.output().unwrap() }
    }

    /// Runs the program and kills it (SIGKILL, without a chance to clean up) as soon as `now` holds. Returns false if it
    /// finishes before.
    #[cfg(unix)]
    pub(crate) fn run_and_kill(&self, arguments: &str, mut now: impl FnMut() -> bool) -> bool {
        let mut child = self.command(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let begun = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if now() {
                child.kill().unwrap();
                return child.wait().unwrap().code().is_none();
            }
            if begun.elapsed() > PATIENCE {
                child.kill().unwrap();
                panic!("flowservo {arguments} neither finished nor reached the moment to kill it");
            }
            std::thread::sleep(Duration::from_micros(100));
        }
        false
    }

    /// Runs the program, presses Ctrl-C as soon as `now` holds, and calls `release` once the program has acknowledged it.
    #[cfg(unix)]
    pub(crate) fn run_and_interrupt(
        &self,
        arguments: &str,
        mut now: impl FnMut() -> bool,
        release: impl FnOnce(),
    ) -> Run {
        let mut command = self.command(arguments);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let begun = Instant::now();
        let mut stderr = String::new();
        while child.try_wait().unwrap().is_none() {
            if now() {
                let interrupt = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
                assert!(interrupt.unwrap().success());
                let mut reader = BufReader::new(child.stderr.take().unwrap());
                while !stderr.contains("Ctrl-C") && reader.read_line(&mut stderr).unwrap() > 0 {}
                release();
                reader.read_to_string(&mut stderr).unwrap();
                break;
            }
            if begun.elapsed() > PATIENCE {
                child.kill().unwrap();
                panic!("flowservo {arguments} neither finished nor reached the moment to interrupt it");
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let mut output = child.wait_with_output().unwrap();
        output.stderr.splice(0..0, stderr.into_bytes());
        Run { arguments: arguments.to_owned(), output }
    }

    /// Starts a training run and presses Ctrl-C after its first checkpoint. A run that finishes first is deleted and
    /// started again.
    #[cfg(unix)]
    pub(crate) fn interrupt_training(&self, out: &str, arguments: &str) -> Run {
        let last = self.path(out).join("last");
        for _ in 0..10 {
            let run = self.run_and_interrupt(arguments, || last.exists(), || ());
            if !run.succeeded() {
                return run;
            }
            std::fs::remove_dir_all(self.path(out)).unwrap();
        }
        panic!("flowservo {arguments} finished ten times before it could be interrupted");
    }

    /// Locks the partial file of a file, as its writer does. The program waits before writing the file until the result is
    /// dropped.
    pub(crate) fn hold(&self, name: &str) -> File {
        let path = self.path(name);
        let partial = path.with_file_name(format!(".{}.partial", path.file_name().unwrap().display()));
        std::fs::create_dir_all(partial.parent().unwrap()).unwrap();
        let file = File::create(partial).unwrap();
        file.lock().unwrap();
        file
    }
}

/// Exit status and output of a finished run.
pub(crate) struct Run {
    arguments: String,
    output: Output,
}

impl Run {
    pub(crate) fn stdout(&self) -> String {
        String::from_utf8_lossy(&self.output.stdout).into_owned()
    }

    pub(crate) fn stderr(&self) -> String {
        String::from_utf8_lossy(&self.output.stderr).into_owned()
    }

    pub(crate) fn succeeded(&self) -> bool {
        self.output.status.success()
    }

    /// Asserts success.
    #[track_caller]
    pub(crate) fn ok(self) -> Self {
        assert!(self.output.status.success(), "flowservo {}\n{}", self.arguments, self.stderr());
        self
    }

    /// Asserts this exit code, no panic, and an error message that contains all of `words`.
    #[track_caller]
    pub(crate) fn fails(&self, code: i32, words: &[&str]) {
        let stderr = self.stderr();
        let context = format!("flowservo {}\nexit {:?}\n{stderr}", self.arguments, self.output.status.code());
        assert_eq!(self.output.status.code(), Some(code), "{context}");
        assert!(!stderr.contains("panicked"), "{context}");
        for word in words {
            assert!(stderr.contains(word), "expected {word:?} in the error of\n{context}");
        }
    }

    /// The JSON object on the last line of standard output.
    #[track_caller]
    pub(crate) fn json(&self) -> serde_json::Value {
        let stdout = self.stdout();
        serde_json::from_str(stdout.lines().last().unwrap_or_default())
            .unwrap_or_else(|error| panic!("flowservo {}: {error} in\n{stdout}", self.arguments))
    }
}

/// The repository's root.
pub(crate) fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}
