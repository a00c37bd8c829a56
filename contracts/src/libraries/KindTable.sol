// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @title Short numbers for kinds, so that a task or service does not spend a storage word on its kind.
library KindTable {
    /// @notice An organization uses up to 255 kinds in its life.
    error TooManyKinds(bytes32 kind, uint256 max);

    struct Table {
        uint8 count;
        mapping(bytes32 kind => uint8) ids;
        mapping(uint8 id => bytes32) kinds;
    }

    /// @notice Returns the number of a kind, and assigns it at the first use.
    /// @param table the numbers of one contract
    /// @param kind a kind that the organization allows
    function idOf(Table storage table, bytes32 kind) internal returns (uint8 id) {
        id = table.ids[kind];
        if (id == 0) {
            if (table.count == type(uint8).max) revert TooManyKinds(kind, type(uint8).max);
            id = ++table.count;
            table.ids[kind] = id;
            table.kinds[id] = kind;
        }
    }
}
