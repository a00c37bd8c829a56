// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IECoin} from "../src/IECoin.sol";
import {Fixture} from "./Fixture.sol";

contract IECoinTest is Fixture {
    function test_theSupplyIsWhatWasMintedFirst() public view {
        assertEq(coin.totalSupply(), 8000 ether);
        assertEq(coin.balanceOf(address(organization)), 2000 ether);
    }

    function test_everyHolderNeedsAnAmount() public {
        vm.expectRevert(abi.encodeWithSelector(IECoin.LengthMismatch.selector, 1, 0));
        deployed("IECoin", abi.encode(new address[](1), new uint256[](0)));
    }

    function test_aPermitIsAnApprovalBySignature() public {
        (address owner, uint256 key) = makeAddrAndKey("owner");
        bytes32 digest = keccak256(
            abi.encodePacked(
                hex"1901",
                coin.DOMAIN_SEPARATOR(),
                keccak256(
                    abi.encode(
                        keccak256(
                            "Permit(address owner,address spender,uint256 value,uint256 nonce,uint256 deadline)"
                        ),
                        owner,
                        address(tasks),
                        5 ether,
                        coin.nonces(owner),
                        block.timestamp
                    )
                )
            )
        );
        (uint8 v, bytes32 r, bytes32 s) = vm.sign(key, digest);
        coin.permit(owner, address(tasks), 5 ether, block.timestamp, v, r, s);
        assertEq(coin.allowance(owner, address(tasks)), 5 ether);
        assertEq(coin.nonces(owner), 1);
    }
}
