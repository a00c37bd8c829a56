// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @title Short numbers for kinds, so that a task or service does not spend a storage word on its kind.
library KindTable {
    struct Table {
        uint16 count;
        mapping(bytes32 kind => uint16) ids;
        mapping(uint16 id => bytes32) kinds;
    }

    /// @notice The number of `kind`, assigned at its first use. Kinds are few, because the organization allows them.
    function idOf(Table storage table, bytes32 kind) internal returns (uint16 id) {
        id = table.ids[kind];
        if (id == 0) {
            id = ++table.count;
            table.ids[kind] = id;
            table.kinds[id] = kind;
        }
    }
}
