//! A temporary folder, and the program run in it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A safetensors file with this text as its one tensor.
pub(crate) fn safetensors(text: &str) -> String {
    let size = text.len();
    let header = format!(r#"{{"w":{{"dtype":"U8","shape":[{size}],"data_offsets":[0,{size}]}}}}"#);
    let length = (header.len() as u64).to_le_bytes().map(char::from);
    // A header as short as this has a length of one ASCII character.
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

    /// All files below a folder in it, with their content, by their path there.
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

    /// Runs `flowservo` with these arguments, separated by spaces.
    pub(crate) fn run(&self, arguments: &str) -> Run {
        let output = Command::new(env!("CARGO_BIN_EXE_flowservo"))
            .args(arguments.split_whitespace())
            .current_dir(self.0.path())
            .output()
            .unwrap();
        Run { arguments: arguments.to_owned(), output }
    }

    /// Runs it with standard output, and where asked standard error, as a pipe that no one reads.
    pub(crate) fn run_unread(&self, arguments: &str, also_errors: bool) -> Run {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let errors = if also_errors { writer.try_clone().unwrap().into() } else { Stdio::piped() };
        let mut program = Command::new(env!("CARGO_BIN_EXE_flowservo"));
        program.args(arguments.split_whitespace()).current_dir(self.0.path());
        let output = program.stdout(writer).stderr(errors).output().unwrap();
        Run { arguments: arguments.to_owned(), output }
    }

    /// Runs it with these Vulkan drivers alone, named by the files that announce them, and without OpenGL.
    #[cfg(feature = "wgpu-software")]
    pub(crate) fn run_with_driver(&self, driver: &str, arguments: &str) -> Run {
        let mut program = Command::new(env!("CARGO_BIN_EXE_flowservo"));
        program.args(arguments.split_whitespace()).current_dir(self.0.path());
        program.env("VK_DRIVER_FILES", driver).env("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent.json");
        // A layer of Mesa's that asks the windowing system, and says so if there is none.
        let output = program.env("NODEVICE_SELECT", "1").output().unwrap();
        Run { arguments: arguments.to_owned(), output }
    }

    /// Runs it with every file that it writes limited to this many blocks of 512 or 1024 bytes: past that a write fails, as
    /// on a full disk.
    #[cfg(unix)]
    pub(crate) fn run_with_little_space(&self, blocks: u32, arguments: &str) -> Run {
        let program = env!("CARGO_BIN_EXE_flowservo");
        let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec {program} {arguments}");
        let output = Command::new("sh").arg("-c").arg(script).current_dir(self.0.path()).output().unwrap();
        Run { arguments: arguments.to_owned(), output }
    }

    /// Runs it and kills it (SIGKILL: it cannot tidy up) as soon as `now` holds. Says whether it lived that long.
    #[cfg(unix)]
    pub(crate) fn run_and_kill(&self, arguments: &str, mut now: impl FnMut() -> bool) -> bool {
        let mut child = Command::new(env!("CARGO_BIN_EXE_flowservo"))
            .args(arguments.split_whitespace())
            .current_dir(self.0.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        while child.try_wait().unwrap().is_none() {
            if now() {
                child.kill().unwrap();
                return child.wait().unwrap().code().is_none();
            }
            std::thread::sleep(std::time::Duration::from_micros(100));
        }
        false
    }

    /// Runs it and presses Ctrl-C as soon as `begun` exists.
    #[cfg(unix)]
    pub(crate) fn run_until(&self, begun: &str, arguments: &str) -> Run {
        let child = Command::new(env!("CARGO_BIN_EXE_flowservo"))
            .args(arguments.split_whitespace())
            .current_dir(self.0.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let begun = self.path(begun);
        for _ in 0..3000 {
            if begun.exists() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        let output = child.wait_with_output().unwrap();
        Run { arguments: arguments.to_owned(), output }
    }
}

/// What a run of the program left behind.
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

    /// The run succeeded.
    #[track_caller]
    pub(crate) fn ok(self) -> Self {
        assert!(self.output.status.success(), "flowservo {}\n{}", self.arguments, self.stderr());
        self
    }

    /// The run ended with this exit code, no panic, and an error that says all of `words`.
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
