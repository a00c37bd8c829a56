// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Create2} from "@openzeppelin/contracts/utils/Create2.sol";

/// @title Judges who are read together: they are the code of a contract.
/// @notice To read all of them costs 2,600 gas, and not 2,100 for each. A list never changes. Whoever wants the same judges
/// again gets the same list.
library JudgeLists {
    /// @dev Creates a contract whose code is whatever follows:
    /// PUSH1 11, CODESIZE, SUB, DUP1, PUSH1 11, PUSH0, CODECOPY, PUSH0, RETURN.
    bytes11 private constant CREATOR = hex"600b380380600b5f395ff3";
    /// @dev The first byte of each list: who calls it does nothing, whatever the bytes of keys and owners would mean.
    bytes1 private constant STOP = 0x00;
    uint256 private constant ADDRESS_BYTES = 20;
    /// @dev Key, owner and seat.
    uint256 private constant JUDGE_BYTES = 41;

    /// @notice Returns a judge as it stands in a list.
    /// @param key what it signs with
    /// @param owner for whom it works
    /// @param seat its number
    function pack(address key, address owner, uint8 seat) internal pure returns (bytes memory) {
        return abi.encodePacked(key, owner, seat);
    }

    /// @notice Returns the list of these judges, which nobody but this contract can have written.
    /// @param judges one after another, each as `pack` returns it
    function write(bytes memory judges) internal returns (address list) {
        bytes memory creation = abi.encodePacked(CREATOR, STOP, judges);
        list = Create2.computeAddress(0, keccak256(creation));
        // What it returns is known.
        // slither-disable-next-line unused-return
        if (list.code.length == 0) Create2.deploy(0, 0, creation);
    }

    /// @notice Returns the judge who signs with `key`, and how many stand before it; 0 as owner if nobody does.
    /// @param code of the list
    /// @param key what the judge signs with
    function find(bytes memory code, address key)
        internal
        pure
        returns (uint256 place, address owner, uint8 seat)
    {
        uint256 wanted = uint160(key);
        // By hand, because a judge has no whole words. With two words for each, a list would cost half as much again to write.
        assembly ("memory-safe") {
            let first := add(code, 33) // behind the length and STOP
            let end := add(add(code, 32), mload(code))
            for { let judge := first } lt(judge, end) { judge := add(judge, JUDGE_BYTES) } {
                if eq(shr(96, mload(judge)), wanted) {
                    let rest := mload(add(judge, ADDRESS_BYTES))
                    owner := shr(96, rest)
                    seat := and(shr(88, rest), 0xff)
                    place := div(sub(judge, first), JUDGE_BYTES)
                    break
                }
            }
        }
    }
}
