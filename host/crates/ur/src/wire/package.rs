//! The packages of RTDE, protocol 2.

use spherecal_cyclic::wire_enum;

use super::WireError;
use super::bytes::Bytes;
use super::value::{FieldType, Value};

/// The protocol that is spoken here.
pub const PROTOCOL: u16 = 2;
/// Bytes of a package's header.
pub const HEADER_SIZE: usize = 3;
/// The longest list of names in a request, bytes.
pub const MAX_NAMES: usize = 2048;
/// The largest request that a robot side accepts, bytes: a list of names and a rate, or inputs.
pub const MAX_REQUEST: usize = 4096;
/// The largest package of a robot, bytes: what its header can say.
pub const MAX_ANSWER: usize = u16::MAX as usize;

wire_enum! {
    /// The kind of a package: the letter in its header.
    PackageKind(i32), "package kind" {
        /// Inputs that a client will send.
        SetupInputs = 73, "setup inputs";
        /// A message for people.
        Text = 77, "text message";
        /// Outputs that a client wants.
        SetupOutputs = 79, "setup outputs";
        /// The stream stops.
        Pause = 80, "pause";
        /// The stream begins.
        Start = 83, "start";
        /// Values.
        Data = 85, "data package";
        /// The client names a protocol.
        ProtocolVersion = 86, "protocol version";
        /// The client asks for the version of the software.
        ControllerVersion = 118, "controller version";
    }
}

wire_enum! {
    /// How serious a text message is.
    TextLevel(i32), "text level" {
        /// The robot failed.
        Exception = 0, "exception";
        /// Something does not work.
        Error = 1, "error";
        /// Something may not work.
        Warning = 2, "warning";
        /// For information.
        Info = 3, "info";
    }
}

/// A message for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextMessage {
    /// What it says. At most 255 bytes travel.
    pub message: String,
    /// Who says it. At most 255 bytes travel.
    pub source: String,
    /// How serious it is.
    pub level: TextLevel,
}

/// The version of the robot's software.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ControllerVersion {
    /// 3 on CB3, 5 on e-Series, 10 on PolyScope X.
    pub major: u32,
    /// The second number.
    pub minor: u32,
    /// The third number.
    pub bugfix: u32,
    /// The fourth number.
    pub build: u32,
}

impl ControllerVersion {
    /// The first PolyScope X with torques.
    pub const POLYSCOPE_X: Self = Self {
        major: 10,
        minor: 12,
        bugfix: 1,
        build: 0,
    };

    /// Whether this is PolyScope X: it has a Robot API (since 10.11.0) and no dashboard.
    pub const fn is_polyscope_x(&self) -> bool {
        self.major >= Self::POLYSCOPE_X.major
    }

    /// Whether programs have `direct_torque` with scales of the friction: since 5.25.1 and 10.12.1.
    pub fn has_torques(&self) -> bool {
        let Self {
            major, minor, bugfix, ..
        } = Self::POLYSCOPE_X;
        let since = if self.is_polyscope_x() {
            (major, minor, bugfix)
        } else {
            (5, 25, 1)
        };
        (self.major, self.minor, self.bugfix) >= since
    }
}

impl std::fmt::Display for ControllerVersion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}.{}.{}", self.major, self.minor, self.bugfix, self.build)
    }
}

/// What a client sends.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Asks for a protocol.
    ProtocolVersion(u16),
    /// Asks for the version of the software.
    ControllerVersion,
    /// Asks for these fields at this rate, in Hz.
    SetupOutputs {
        /// Data packages per second.
        rate_hz: f64,
        /// Names of the fields.
        names: Vec<String>,
    },
    /// Announces that these fields will be sent.
    SetupInputs {
        /// Names of the fields.
        names: Vec<String>,
    },
    /// Asks for the stream.
    Start,
    /// Stops the stream.
    Pause,
    /// Values of inputs: number of the recipe, and their bytes.
    Data(u8, Vec<u8>),
    /// A message for the robot's log.
    Text(TextMessage),
}

/// The robot's answer to a setup.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Setup {
    /// Number of the recipe; 0: refused.
    pub recipe: u8,
    /// For each name its type, [`NOT_FOUND`](super::NOT_FOUND) or [`IN_USE`](super::IN_USE).
    pub types: Vec<String>,
}

/// What a robot sends.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Whether the protocol is spoken.
    ProtocolVersion(bool),
    /// The version of the software.
    ControllerVersion(ControllerVersion),
    /// The types of the outputs.
    SetupOutputs(Setup),
    /// The types of the inputs.
    SetupInputs(Setup),
    /// Whether the stream begins.
    Start(bool),
    /// Whether the stream stops.
    Pause(bool),
    /// Values of outputs: number of the recipe, and their bytes.
    Data(u8, Vec<u8>),
    /// A message for people.
    Text(TextMessage),
}

/// Takes the first package from what has come: its kind and its payload. `None` while it is not whole.
///
/// # Errors
/// [`WireError::Size`] for a size below the header's or above `most`, [`WireError::UnknownValue`] for a kind that is none.
pub fn take_package(received: &mut Vec<u8>, most: usize) -> Result<Option<(PackageKind, Vec<u8>)>, WireError> {
    let Some(header) = received.first_chunk::<HEADER_SIZE>() else {
        return Ok(None);
    };
    let size = usize::from(u16::from_be_bytes([header[0], header[1]]));
    if !(HEADER_SIZE..=most).contains(&size) {
        let least = HEADER_SIZE;
        return Err(WireError::Size { size, least, most });
    }
    let kind = PackageKind::from_number(header[2].into())?;
    if received.len() < size {
        return Ok(None);
    }
    let mut package: Vec<u8> = received.drain(..size).collect();
    package.drain(..HEADER_SIZE);
    Ok(Some((kind, package)))
}

/// A whole package. A payload that is longer than a package can be is cut: no caller makes one.
fn package(kind: PackageKind, payload: &[u8]) -> Vec<u8> {
    let payload = payload.get(..MAX_ANSWER - HEADER_SIZE).unwrap_or(payload);
    let size = (payload.len() + HEADER_SIZE) as u16;
    let mut out = Vec::with_capacity(size.into());
    out.extend(size.to_be_bytes());
    out.push(kind.number() as u8);
    out.extend(payload);
    out
}

fn names(text: &str) -> Vec<String> {
    text.split(',')
        .filter(|name| !name.is_empty())
        .map(str::to_owned)
        .collect()
}

impl TextMessage {
    fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        for text in [&self.message, &self.source] {
            let cut = text.floor_char_boundary(255);
            out.push(cut as u8);
            out.extend(&text.as_bytes()[..cut]);
        }
        out.push(self.level.number() as u8);
        out
    }

    fn decode(mut bytes: Bytes<'_>) -> Result<Self, WireError> {
        let mut text = |field| {
            let size = bytes.u8(field)?;
            // Robots are known to send texts in their language's old encoding.
            Ok(String::from_utf8_lossy(bytes.take(size.into(), field)?).into_owned())
        };
        let (message, source) = (text("message")?, text("source")?);
        let level = TextLevel::from_number(bytes.u8("level")?.into())?;
        bytes.end()?;
        Ok(Self { message, source, level })
    }
}

impl Request {
    /// The package.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::ProtocolVersion(version) => package(PackageKind::ProtocolVersion, &version.to_be_bytes()),
            Self::ControllerVersion => package(PackageKind::ControllerVersion, &[]),
            Self::SetupOutputs { rate_hz, names } => {
                let mut payload = rate_hz.to_be_bytes().to_vec();
                payload.extend(names.join(",").bytes());
                package(PackageKind::SetupOutputs, &payload)
            }
            Self::SetupInputs { names } => package(PackageKind::SetupInputs, names.join(",").as_bytes()),
            Self::Start => package(PackageKind::Start, &[]),
            Self::Pause => package(PackageKind::Pause, &[]),
            Self::Data(recipe, values) => package(PackageKind::Data, &[&[*recipe], values.as_slice()].concat()),
            Self::Text(message) => package(PackageKind::Text, &message.encode()),
        }
    }

    /// Reads the payload of a request.
    ///
    /// # Errors
    /// A [`WireError`] if it is none.
    pub fn decode(kind: PackageKind, payload: &[u8]) -> Result<Self, WireError> {
        let mut bytes = Bytes::new(payload, kind.name());
        let request = match kind {
            PackageKind::ProtocolVersion => Self::ProtocolVersion(bytes.u16("version")?),
            PackageKind::ControllerVersion => Self::ControllerVersion,
            PackageKind::SetupOutputs => {
                let rate_hz = bytes.f64("frequency")?;
                if !rate_hz.is_finite() {
                    return Err(WireError::NotFinite { field: "frequency" });
                }
                let names = names(bytes.text()?);
                Self::SetupOutputs { rate_hz, names }
            }
            PackageKind::SetupInputs => Self::SetupInputs {
                names: names(bytes.text()?),
            },
            PackageKind::Start => Self::Start,
            PackageKind::Pause => Self::Pause,
            PackageKind::Data => Self::Data(bytes.u8("recipe")?, bytes.rest().to_vec()),
            PackageKind::Text => return Ok(Self::Text(TextMessage::decode(bytes)?)),
        };
        bytes.end()?;
        Ok(request)
    }
}

impl Setup {
    fn encode(&self) -> Vec<u8> {
        let mut out = vec![self.recipe];
        out.extend(self.types.join(",").bytes());
        out
    }

    fn decode(bytes: &mut Bytes<'_>) -> Result<Self, WireError> {
        let recipe = bytes.u8("recipe")?;
        let types = names(bytes.text()?);
        Ok(Self { recipe, types })
    }
}

impl Answer {
    /// Its kind.
    pub const fn kind(&self) -> PackageKind {
        match self {
            Self::ProtocolVersion(_) => PackageKind::ProtocolVersion,
            Self::ControllerVersion(_) => PackageKind::ControllerVersion,
            Self::SetupOutputs(_) => PackageKind::SetupOutputs,
            Self::SetupInputs(_) => PackageKind::SetupInputs,
            Self::Start(_) => PackageKind::Start,
            Self::Pause(_) => PackageKind::Pause,
            Self::Data(..) => PackageKind::Data,
            Self::Text(_) => PackageKind::Text,
        }
    }

    /// The package.
    pub fn encode(&self) -> Vec<u8> {
        let payload = match self {
            Self::ProtocolVersion(accepted) | Self::Start(accepted) | Self::Pause(accepted) => vec![(*accepted).into()],
            Self::ControllerVersion(v) => [v.major, v.minor, v.bugfix, v.build]
                .iter()
                .flat_map(|number| number.to_be_bytes())
                .collect(),
            Self::SetupOutputs(setup) | Self::SetupInputs(setup) => setup.encode(),
            Self::Data(recipe, values) => [&[*recipe], values.as_slice()].concat(),
            Self::Text(message) => message.encode(),
        };
        package(self.kind(), &payload)
    }

    /// Reads the payload of an answer.
    ///
    /// # Errors
    /// A [`WireError`] if it is none.
    pub fn decode(kind: PackageKind, payload: &[u8]) -> Result<Self, WireError> {
        let mut bytes = Bytes::new(payload, kind.name());
        let answer = match kind {
            PackageKind::ProtocolVersion => Self::ProtocolVersion(bytes.u8("accepted")? != 0),
            PackageKind::ControllerVersion => Self::ControllerVersion(ControllerVersion {
                major: bytes.u32("major")?,
                minor: bytes.u32("minor")?,
                bugfix: bytes.u32("bugfix")?,
                build: bytes.u32("build")?,
            }),
            PackageKind::SetupOutputs => Self::SetupOutputs(Setup::decode(&mut bytes)?),
            PackageKind::SetupInputs => Self::SetupInputs(Setup::decode(&mut bytes)?),
            PackageKind::Start => Self::Start(bytes.u8("accepted")? != 0),
            PackageKind::Pause => Self::Pause(bytes.u8("accepted")? != 0),
            PackageKind::Data => Self::Data(bytes.u8("recipe")?, bytes.rest().to_vec()),
            PackageKind::Text => return Ok(Self::Text(TextMessage::decode(bytes)?)),
        };
        bytes.end()?;
        Ok(answer)
    }
}

/// The fields of a data package, in their order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recipe {
    /// Name and type of each field.
    pub fields: Vec<(String, FieldType)>,
}

impl Recipe {
    /// Reads the values of a data package.
    ///
    /// # Errors
    /// A [`WireError`] if there are fewer or more bytes than the fields need.
    pub fn decode(&self, values: &[u8]) -> Result<Vec<Value>, WireError> {
        let mut bytes = Bytes::new(values, PackageKind::Data.name());
        let read = self.fields.iter().map(|(_, kind)| Value::decode(*kind, &mut bytes));
        let read: Vec<Value> = read.collect::<Result<_, _>>()?;
        bytes.end()?;
        Ok(read)
    }
}
