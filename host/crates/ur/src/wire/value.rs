//! The values of RTDE fields.

use spherecal_cyclic::named_enum;

use super::WireError;
use super::bytes::Bytes;

/// In place of a type: the robot does not know this field.
pub const NOT_FOUND: &str = "NOT_FOUND";
/// In place of a type: another client writes this register.
pub const IN_USE: &str = "IN_USE";

named_enum! {
    /// The type of a field.
    FieldType {
        /// True or false, one byte.
        Bool, "BOOL";
        /// One byte.
        Uint8, "UINT8";
        /// Four bytes.
        Uint32, "UINT32";
        /// Eight bytes.
        Uint64, "UINT64";
        /// Four bytes, signed.
        Int32, "INT32";
        /// Eight bytes.
        Double, "DOUBLE";
        /// Three doubles.
        Vector3D, "VECTOR3D";
        /// Six doubles.
        Vector6D, "VECTOR6D";
        /// Six signed integers of four bytes.
        Vector6Int32, "VECTOR6INT32";
        /// Six integers of four bytes.
        Vector6Uint32, "VECTOR6UINT32";
    }
}

impl FieldType {
    /// The type with this name.
    ///
    /// # Errors
    /// [`WireError::UnknownType`].
    pub fn from_name(name: &str) -> Result<Self, WireError> {
        let found = Self::ALL.iter().copied().find(|one| one.name() == name);
        found.ok_or_else(|| WireError::UnknownType { name: name.to_owned() })
    }

    /// Bytes of a value.
    pub const fn size(self) -> usize {
        match self {
            Self::Bool | Self::Uint8 => 1,
            Self::Uint32 | Self::Int32 => 4,
            Self::Uint64 | Self::Double => 8,
            Self::Vector3D | Self::Vector6Int32 | Self::Vector6Uint32 => 24,
            Self::Vector6D => 48,
        }
    }

    /// Zero.
    pub const fn zero(self) -> Value {
        match self {
            Self::Bool => Value::Bool(false),
            Self::Uint8 => Value::Uint8(0),
            Self::Uint32 => Value::Uint32(0),
            Self::Uint64 => Value::Uint64(0),
            Self::Int32 => Value::Int32(0),
            Self::Double => Value::Double(0.0),
            Self::Vector3D => Value::Vector3D([0.0; 3]),
            Self::Vector6D => Value::Vector6D([0.0; 6]),
            Self::Vector6Int32 => Value::Vector6Int32([0; 6]),
            Self::Vector6Uint32 => Value::Vector6Uint32([0; 6]),
        }
    }
}

/// A value of a field, in the unit of the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// True or false.
    Bool(bool),
    /// One byte.
    Uint8(u8),
    /// Four bytes.
    Uint32(u32),
    /// Eight bytes.
    Uint64(u64),
    /// Four bytes, signed.
    Int32(i32),
    /// A double.
    Double(f64),
    /// Three doubles.
    Vector3D([f64; 3]),
    /// Six doubles.
    Vector6D([f64; 6]),
    /// Six signed integers.
    Vector6Int32([i32; 6]),
    /// Six integers.
    Vector6Uint32([u32; 6]),
}

impl Value {
    /// Its type.
    pub const fn field_type(&self) -> FieldType {
        match self {
            Self::Bool(_) => FieldType::Bool,
            Self::Uint8(_) => FieldType::Uint8,
            Self::Uint32(_) => FieldType::Uint32,
            Self::Uint64(_) => FieldType::Uint64,
            Self::Int32(_) => FieldType::Int32,
            Self::Double(_) => FieldType::Double,
            Self::Vector3D(_) => FieldType::Vector3D,
            Self::Vector6D(_) => FieldType::Vector6D,
            Self::Vector6Int32(_) => FieldType::Vector6Int32,
            Self::Vector6Uint32(_) => FieldType::Vector6Uint32,
        }
    }

    /// Appends its bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        match self {
            Self::Bool(v) => out.push((*v).into()),
            Self::Uint8(v) => out.push(*v),
            Self::Uint32(v) => out.extend(v.to_be_bytes()),
            Self::Uint64(v) => out.extend(v.to_be_bytes()),
            Self::Int32(v) => out.extend(v.to_be_bytes()),
            Self::Double(v) => out.extend(v.to_be_bytes()),
            Self::Vector3D(v) => v.iter().for_each(|x| out.extend(x.to_be_bytes())),
            Self::Vector6D(v) => v.iter().for_each(|x| out.extend(x.to_be_bytes())),
            Self::Vector6Int32(v) => v.iter().for_each(|x| out.extend(x.to_be_bytes())),
            Self::Vector6Uint32(v) => v.iter().for_each(|x| out.extend(x.to_be_bytes())),
        }
    }

    /// The next value of a package.
    pub(super) fn decode(kind: FieldType, bytes: &mut Bytes<'_>) -> Result<Self, WireError> {
        let field = kind.name();
        let mut value = kind.zero();
        match &mut value {
            Self::Bool(v) => *v = bytes.u8(field)? != 0,
            Self::Uint8(v) => *v = bytes.u8(field)?,
            Self::Uint32(v) => *v = bytes.u32(field)?,
            Self::Uint64(v) => *v = bytes.u64(field)?,
            Self::Int32(v) => *v = bytes.i32(field)?,
            Self::Double(v) => *v = bytes.f64(field)?,
            Self::Vector3D(v) => v.iter_mut().try_for_each(|x| bytes.f64(field).map(|read| *x = read))?,
            Self::Vector6D(v) => v.iter_mut().try_for_each(|x| bytes.f64(field).map(|read| *x = read))?,
            Self::Vector6Int32(v) => v.iter_mut().try_for_each(|x| bytes.i32(field).map(|read| *x = read))?,
            Self::Vector6Uint32(v) => v.iter_mut().try_for_each(|x| bytes.u32(field).map(|read| *x = read))?,
        }
        Ok(value)
    }
}
