// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @title Maximum lengths of texts. Texts are only in events, which every node stores and every index reads.
library Texts {
    error TextTooLong(uint256 length, uint256 max);

    /// @notice Bytes of a task's parameters.
    uint256 internal constant MAX_PARAMS = 16_384;

    /// @notice Bytes of any other text: descriptions, reasons, URIs.
    uint256 internal constant MAX = 8192;

    function requireParams(string calldata text) internal pure {
        _require(text, MAX_PARAMS);
    }

    function requireText(string calldata text) internal pure {
        _require(text, MAX);
    }

    function _require(string calldata text, uint256 max) private pure {
        if (bytes(text).length > max) revert TextTooLong(bytes(text).length, max);
    }
}
