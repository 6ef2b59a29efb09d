//! Enumerations with names, and such on the wire.

/// An enumeration with a text for each value: `Name { Variant = number, "text"; }`; the numbers may be left out.
#[macro_export]
macro_rules! named_enum {
    ($(#[$doc:meta])* $name:ident { $($(#[$vdoc:meta])* $variant:ident $(= $number:literal)?, $text:literal;)+ }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum $name { $($(#[$vdoc])* $variant $(= $number)?,)+ }

        impl $name {
            /// All values, in the order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The name as the maker's documentation writes it, or else what the value says.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $text,)+ }
            }
        }

        impl ::std::fmt::Display for $name {
            fn fmt(&self, f: &mut ::std::fmt::Formatter<'_>) -> ::std::fmt::Result { f.write_str(self.name()) }
        }
    };
}

/// An enumeration on the wire: its variants with their numbers and the names that the maker gives them.
///
/// `Name(type), "field" { Variant = number, "text"; }`: the numbers have the unsigned type; the calling module has a
/// `WireError::UnknownValue { field, value }` whose value has that type.
#[macro_export]
macro_rules! wire_enum {
    ($(#[$doc:meta])* $name:ident($number_type:ty), $field:literal {
        $($(#[$vdoc:meta])* $variant:ident = $number:literal, $text:literal;)+
    }) => {
        $crate::named_enum! { $(#[$doc])* $name { $($(#[$vdoc])* $variant = $number, $text;)+ } }

        impl $name {
            /// The number on the wire.
            pub const fn number(self) -> $number_type { self as $number_type }

            /// The value with this number.
            ///
            /// # Errors
            /// [`WireError::UnknownValue`] for a number without meaning.
            pub const fn from_number(number: $number_type) -> Result<Self, WireError> {
                match number {
                    $($number => Ok(Self::$variant),)+
                    value => Err(WireError::UnknownValue { field: $field, value }),
                }
            }
        }
    };
}
