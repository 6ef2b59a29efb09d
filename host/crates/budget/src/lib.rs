//! What a peer or a file from outside may take of the program: every limit of every wire, in one table, with its unit and
//! its reason. Each is applied by the crate that speaks the wire. A limit that the format of a message sets is with the
//! format.

use std::time::Duration;

/// Time within which a peer earns its place by something valid: a client by its first frame or request (TLS included), a
/// server by its hello or first answer. An honest one needs milliseconds; a person who waits notices 5 s.
pub const HANDSHAKE: Duration = Duration::from_secs(5);
/// Time to connect. A system that is switched off answers nothing.
pub const CONNECT: Duration = Duration::from_secs(5);

/// Drive link and host link.
pub mod link {
    use std::time::Duration;

    /// Time that a controller may take for its hello: it greets the next host when the silent one before has given way
    /// ([`SILENT`]), at the end of its period.
    pub const CONTROLLER_HELLO: Duration = Duration::from_secs(15);
    /// Time that a drive in lock-step, or a controller, may take for a period. A person may pause a simulator, and a
    /// robot's own interface waits up to 45 s for a person ([`super::robot::START`]).
    pub const PERIOD: Duration = Duration::from_mins(1);
    /// Time that a drive in real time may take for its first state.
    pub const FIRST_STATE: Duration = Duration::from_secs(5);
    /// Time for which a client may be silent: in real time at all, in lock-step if another one waits.
    pub const SILENT: Duration = Duration::from_secs(5);
    /// Time for which bytes may come without a valid frame. A frame takes microseconds.
    pub const NO_FRAME: Duration = Duration::from_secs(5);
    /// Bytes that may come without a valid frame: some hundred of the largest frames.
    pub const NO_FRAME_BYTES: usize = 1 << 20;
    /// Time within which a peer must read what it is sent.
    pub const READ: Duration = Duration::from_secs(5);
    /// Time within which a serial device must take a byte.
    pub const SERIAL_WRITE: Duration = Duration::from_secs(2);
    /// Messages that may have piled up while this side was stopped: those of 2 s. More than two a period beyond them are a
    /// flood.
    pub const PILED_UP: u64 = 2_000;
    /// Periods in which a drive in lock-step may have sent more than the one state that it owes: a drive that counts on
    /// after a pause catches up in some.
    pub const AHEAD: u32 = 50;
    /// Commands for older states that a controller in lock-step may send in a row.
    pub const LATE: u64 = 1000;
    /// Bytes of a turn of the host link: a few frames, and what was repeated while the other side stood.
    pub const TURN_BYTES: usize = 1 << 20;
    /// Bytes that may wait for a host in real time: some hundred periods. One that falls behind further is disconnected.
    pub const BACKLOG_BYTES: usize = 1 << 20;
    /// Largest frames of a host that a controller in real time takes in one period; further ones wait. A host sends one or
    /// two.
    pub const FRAMES_DOWN: usize = 4;
    /// Peers that wait for a place, of 12 kB each at most. One more closes the connection that has waited longest: with 16
    /// places, 350 connections a second closed that of an honest peer, on a busy machine, before its first frame had come.
    pub const WAITING: usize = 64;
    /// Datagrams of others that a drive over UDP throws away at a time, before it goes on with its period: 256,000 in a second.
    pub const STRANGERS: usize = 256;
    /// Largest frames that a peer may send before its first valid frame is complete.
    pub const WAITING_FRAMES: usize = 4;
}

/// The robots' own interfaces.
pub mod robot {
    use std::time::Duration;

    /// Time to connect. A control unit is in the same network.
    pub const CONNECT: Duration = Duration::from_secs(3);
    /// Time for an answer of a robot of Universal Robots; it answers within a cycle.
    pub const UR_ANSWER: Duration = Duration::from_secs(3);
    /// Time for a line of its dashboard or an answer of its Robot API, and for it to take a request. The drive asks between two
    /// periods.
    pub const LINE: Duration = Duration::from_secs(1);
    /// Bytes of a line of the dashboard. Real ones have some 60.
    pub const LINE_BYTES: usize = 1024;
    /// Bytes of a request to the Robot API or of its answer, head and body. Those that are needed have some 200.
    pub const HTTP_BYTES: usize = 16 << 10;
    /// Time for the other answers of a Franka robot: error recovery opens brakes.
    pub const FRANKA_ANSWER: Duration = Duration::from_secs(10);
    /// Time in which a Franka robot must show a motion's begin or end.
    pub const TRANSITION: Duration = Duration::from_secs(2);
    /// Bytes of a response of a Franka robot. A robot model in URDF has some 10 kB, a model library some 100 kB.
    pub const RESPONSE_BYTES: usize = 16 << 20;
    /// Bytes of a package of the primary interface of Universal Robots. States have some 1,500.
    pub const PACKAGE_BYTES: usize = 65_536;
    /// Time for the cabinet's first message, and then for a good connection: a person starts the application.
    pub const FIRST: Duration = Duration::from_mins(1);
    /// Time for a person who starts the application's motion; shorter than [`super::link::PERIOD`].
    pub const START: Duration = Duration::from_secs(45);
    /// Time for which a robot may be silent before its drive gives up: a restart takes less.
    pub const GIVE_UP: Duration = Duration::from_mins(1);
    /// Time for which a robot that is only read may be silent.
    pub const SILENCE: Duration = Duration::from_secs(3);
    /// Clients of each port of a simulated robot of Universal Robots.
    pub const CLIENTS: usize = 8;
    /// Recipes of inputs of one client there: its number has one byte.
    pub const RECIPES: usize = 255;
    /// Bytes of a script there: that of `ur-rtde` has 50,298.
    pub const SCRIPT_BYTES: usize = 1 << 17;
    /// Bytes that may wait for a client of a simulated robot. One that does not read loses its connection.
    pub const WAITING_BYTES: usize = 1 << 20;
    /// Bytes that a simulated robot takes from a client in one turn: no client keeps it from its clock.
    pub const TAKEN_BYTES: usize = 1 << 16;
}

/// The web page and the services of other machines, both sides.
pub mod services {
    use std::time::Duration;

    /// Connections at one time. Together with the limits of one connection this limits the memory of a server, which has
    /// few honest clients.
    pub const CONNECTIONS: usize = 128;
    /// Connections of one address beyond loopback.
    pub const CONNECTIONS_OF_ONE_ADDRESS: usize = 32;
    /// Connections that may wait to be accepted. Where more wait, the system drops the next one, and its client tries
    /// again only after a second. The system may have a lower limit (`net.core.somaxconn`).
    pub const WAITING: u32 = 4096;
    /// Time after which a connection without a complete request is closed first, where there are too many.
    pub const LATE: Duration = Duration::from_secs(1);
    /// Responses that wait to be read, each of some MB at most. One more closes the connection that has left one unread
    /// for the longest time: an honest client reads within milliseconds.
    pub const RESPONSES: usize = 32;
    /// Time within which a response must be read. A large report takes some seconds over a slow network.
    pub const RESPONSE: Duration = Duration::from_secs(30);
    /// Age up to which the report of a run in progress is shown again. To write one takes about a second of one core.
    pub const REPORT: Duration = Duration::from_secs(5);
    /// Reports kept, each of some MB at most.
    pub const REPORTS: usize = 8;
    /// Streams of one connection at one time.
    pub const STREAMS: u32 = 32;
    /// Bytes that one connection may have sent and nobody has read yet.
    pub const WINDOW_BYTES: u32 = 256 * 1024;
    /// Bytes of the headers of one request.
    pub const HEADER_BYTES: u32 = 16 * 1024;
    /// Bytes of a message: a whole grid's recordings are about 1 MB.
    pub const MESSAGE_BYTES: usize = 64 << 20;
    /// Bytes of a message of the live view. A frame has about ten thousand.
    pub const LIVE_BYTES: usize = 256 << 10;
    /// Events under way to one browser. One that does not read gets the whole state again.
    pub const EVENTS: usize = 4;
    /// Runs that the live view shows at once. Beyond this number, the run that ended first is removed, or else the oldest.
    pub const RUNS: usize = 32;
    /// Bytes of a message to a robot: an order, or a host's frames of one period, of which each has 2,304 bytes at most.
    pub const TURN_BYTES: usize = 256 * 1024;
    /// Time after which a silent peer is asked whether it lives, and time for its answer. A machine that computes may hold
    /// a process up for some seconds.
    pub const SILENCE: Duration = Duration::from_secs(20);
    /// Time within which a server must answer any but the first request. A store waits 10 s for a lock, and a slow disk
    /// takes 8 s; the host keeps its controller alive for 30 s while it stores.
    pub const ANSWER: Duration = Duration::from_secs(30);
    /// Time within which a tracker must give a shot. A person may have to find the reflector again.
    pub const SHOT: Duration = Duration::from_mins(2);
}

/// Bags, archives and telemetry.
pub mod files {
    /// Bytes of a file of a bag. It is read as a stream.
    pub const BAG_BYTES: u64 = 256 << 30;
    /// Files of a bag. A recorder begins a new one after some GB.
    pub const BAG_FILES: usize = 1000;
    /// Bytes of a record: the most that a stream keeps in memory. A chunk of a bag has some MiB, one of our telemetry
    /// 1 MiB, and a picture of 4K in full colour 25 MiB.
    pub const RECORD_BYTES: usize = 64 << 20;
    /// Bytes that one byte of a file may unpack to, beside a first [`RECORD_BYTES`]: it bounds the processor time. Messages
    /// of a robot unpack to some ten times their size; a file that was made to take time, to thousands.
    pub const UNPACKED: u64 = 200;
    /// Topics of a bag. A robot has some hundred.
    pub const TOPICS: usize = 10_000;
    /// Bytes of the name of a topic or a type.
    pub const NAME_BYTES: usize = 1024;
    /// Measured points and contacts of a bag: more than a year's.
    pub const TARGETS: usize = 2_000_000;
}
