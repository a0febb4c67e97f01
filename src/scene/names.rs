//! Names of the values of enums.

/// Gives an enum a list of its values and a name for each: the word in files, on the command line and in messages.
macro_rules! with_names {
    ($kind:ident { $($value:ident = $name:literal),* $(,)? }) => {
        impl $kind {
            /// Every value, in order.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$value),*];

            /// The name in files, on the command line and in messages.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $name,)*
                }
            }
        }
    };
}

pub(crate) use with_names;
